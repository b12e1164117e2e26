"""Which set points of a teleoperator count, how late they are, and how much speed that leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus.codec import pack, unpack
from pcmrs.errors import PayloadError
from pcmrs.messages import TeleopSetpoint
from pcmrs.messages.teleop import AT_REST, Twist
from pcmrs.spatial import Floats
from pcmrs.workflows._setpoints import Latency, SetpointAdmission, SpeedScale, limit_twist
from pcmrs.workflows.settings import TeleoperationSettings

SETTINGS = TeleoperationSettings()
BEGUN = 100.0
UP: Twist = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
times = st.floats(0.0, 1.0)


@dataclass
class Sent:
    """A set point on its way: how long it takes, and how old the status was that its sender had seen."""

    user: str
    sequence: int
    pause: float
    seen_before: float
    ttl: float


sent = st.builds(
    Sent, st.sampled_from(["alice", "bob"]), st.integers(-2, 12), times, st.floats(-0.1, 2.0), st.floats(-0.1, 1.0)
)


def setpoint(sequence: int, seen: float, ttl: float = 1.0, twist: Twist = UP, sent: float = 0.0) -> TeleopSetpoint:
    return TeleopSetpoint(sequence=sequence, sent=sent, seen=seen, ttl=ttl, twist=twist)


numbers = st.floats(-1.0, 1.0)
twists = st.tuples(*[numbers] * 6).map(lambda six: np.array(six))


@given(st.lists(sent, max_size=20))
def test_only_the_fresh_newer_ones_of_who_engaged_count(many: list[Sent]) -> None:
    admission, now, newest, admitted = SetpointAdmission("alice", BEGUN, SETTINGS), BEGUN, 0, 0
    for each in many:
        now += each.pause
        seen = now - each.seen_before
        counts = each.user == "alice" and each.sequence > newest and BEGUN <= seen <= now and now - seen <= each.ttl
        refused = admission.refused.total()
        admission.take(each.user, setpoint(each.sequence, seen, each.ttl), now)
        assert (admission.refused.total() == refused) == counts
        newest, admitted = (each.sequence, admitted + 1) if counts else (newest, admitted)
        assert admission.sequence == newest
    assert admission.refused.total() == len(many) - admitted


@given(st.integers(0, 8), st.sampled_from([math.nan, math.inf, -math.inf]))
def test_number_that_is_not_finite_is_refused_also_by_the_bus(place: int, wrong: float) -> None:
    numbers = [0.0, BEGUN, 1.0, *UP]
    numbers[place] = wrong
    made = TeleopSetpoint(sequence=1, sent=numbers[0], seen=numbers[1], ttl=numbers[2], twist=tuple(numbers[3:]))  # type: ignore[arg-type]
    admission = SetpointAdmission("alice", BEGUN, SETTINGS)
    admission.take("alice", made, BEGUN + 0.1)
    assert (admission.refused, admission.twist) == ({"not_finite": 1}, AT_REST)
    with pytest.raises(PayloadError):
        unpack(pack(made), TeleopSetpoint)


def test_each_refusal_has_its_code() -> None:
    admission = SetpointAdmission("alice", BEGUN, SETTINGS)
    admission.take("alice", setpoint(5, BEGUN), BEGUN + 0.1)
    for code, user, made in [
        ("other_user", "bob", setpoint(6, BEGUN)),
        ("from_the_future", "alice", setpoint(6, BEGUN + 1.0)),
        ("before_engagement", "alice", setpoint(6, BEGUN - 0.01)),
        ("out_of_sequence", "alice", setpoint(5, BEGUN)),
        ("expired", "alice", setpoint(6, BEGUN, ttl=0.1)),
    ]:
        before = admission.refused.total()
        admission.take(user, made, BEGUN + 0.2)
        assert admission.refused.total() == before + 1
        assert admission.refused[code] == 1
    assert admission.sequence == 5


@given(st.floats(-1e6, 1e6), st.lists(st.tuples(st.floats(0.01, 0.1), st.floats(0.0, 0.3)), min_size=2, max_size=30))
def test_how_the_clocks_differ_matters_to_nothing(difference: float, way: list[tuple[float, float]]) -> None:
    """Against RFC 3550, 6.4.1, with both clocks known: the jitter of transit times."""
    latency, now, jitter, before = Latency(), BEGUN, 0.0, None
    for period, transit in way:
        now += period
        latency.take(now + transit, now + difference, now - 0.02)
        jitter += 0.0 if before is None else (abs(transit - before) - jitter) / 16.0
        before = transit
        assert latency.round_trip == pytest.approx(transit + 0.02)
        assert latency.jitter == pytest.approx(jitter, abs=1e-6)


@given(st.lists(st.tuples(st.floats(0.0, 2.0), st.booleans()), max_size=30))
def test_speed_falls_with_the_delay_and_returns_after_release(course: list[tuple[float, bool]]) -> None:
    scale, held = SpeedScale(SETTINGS), False
    slow, longest = SETTINGS.slow_delay, SETTINGS.longest_delay
    for delay, at_rest in course:
        scale.take(delay, at_rest=at_rest)
        held = delay >= longest or (held and not at_rest)
        assert scale.held == held
        straight = 1.0 if delay <= slow else max(0.0, (longest - delay) / (longest - slow))
        assert scale.value == pytest.approx(0.0 if held else straight)


@given(twists, st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_a_twist_is_shortened_never_turned(twist: Floats, linear: float, angular: float) -> None:
    short = limit_twist(twist, linear, angular)
    assert np.linalg.norm(short[:3]) <= linear + 1e-12
    assert np.linalg.norm(short[3:]) <= angular + 1e-12
    assert np.allclose(np.cross(short[:3], twist[:3]), 0.0)
    assert np.linalg.norm(short) <= np.linalg.norm(twist) + 1e-12
