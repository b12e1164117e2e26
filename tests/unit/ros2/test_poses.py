"""Times and poses at the border to ROS 2: kept, or replaced or refused with a reason."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.ros2 import cdr
from pcmrs.ros2._poses import Stamps, tracker_from_body
from pcmrs.testing.clock import ManualClock


def test_delayed_messages_keep_their_times_of_measurement() -> None:
    """Another machine's clock, 7 s behind ours; the second message comes 0.2 s late, together with the third."""
    clock = ManualClock()
    begun, stamps, found = clock.wall(), Stamps(clock, 1.0), []
    for captured, later in ((0.0, 0.05), (0.1, 0.3), (0.2, 0.0)):
        clock.stall(later)
        found.append(stamps.of(93.0 + captured, 93.0 + captured + 0.03) - begun)
    assert found == pytest.approx([0.02, 0.12, 0.22], abs=1e-6)


@pytest.mark.parametrize("captured", [math.nan, math.inf, -math.inf, 94.0])
def test_implausible_sender_time_is_replaced_by_the_arrival(captured: float) -> None:
    clock = ManualClock()
    assert Stamps(clock, 1.0).of(captured, 93.0) == pytest.approx(clock.wall(), abs=1e-6)


finite = st.floats(-1e3, 1e3)

units = st.tuples(finite, finite, finite, finite).map(lambda turn: [each / (math.hypot(*turn) or 1.0) for each in turn])
ages = st.sampled_from([-1.0, -0.02, -0.005, 0.0, 0.1, 0.19, 0.21, 1.0])  # no nearer to a limit than a stamp resolves


@given(st.tuples(finite, finite, finite), units | st.tuples(finite, finite, finite, finite), ages)
def test_a_pose_is_taken_or_refused_with_a_reason(
    position: Sequence[float], quat_xyzw: Sequence[float], age: float
) -> None:
    message = cdr.PoseStamped(
        cdr.header("tracker", 1e9 - age), cdr.Pose(cdr.Point(*position), cdr.Quaternion(*quat_xyzw))
    )
    if not -0.01 <= age <= 0.2 or not math.isclose(math.hypot(*quat_xyzw), 1.0, abs_tol=1e-3):
        with pytest.raises(RefusalError) as refused:
            tracker_from_body(message, "tracker", 1e9, 0.2)
        assert refused.value.refusal_code in ("stamp_ahead", "stamp_old", "not_unit")
    else:
        assert tracker_from_body(message, "tracker", 1e9, 0.2).translation.tolist() == list(position)
