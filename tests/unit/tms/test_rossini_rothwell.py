"""The threshold by five of ten."""

from __future__ import annotations

import pytest

from pcmrs.errors import RefusalError
from pcmrs.tms.settings import ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from tests.unit.tms.hunts import hunted


def test_it_follows_five_of_ten() -> None:
    answers = {35: False, 40: False, 45: True, 44: True}
    hunt = hunted(
        ThresholdSettings(method="relative_frequency"), lambda intensity: (answers.get(int(intensity), False), None)
    )
    # Up until three of three, then five at once for each step that is answered, six misses for the last.
    asked = [pulse.intensity for pulse in hunt.pulses]
    assert asked == [35.0, 40.0, *[45.0] * 8, *[44.0] * 5, *[43.0] * 6]
    assert hunt.estimate.threshold == 44.0
    assert (hunt.estimate.low, hunt.estimate.high) == (None, None)


@pytest.mark.parametrize(
    ("answered", "threshold"), [("ynynynynnn", 51.0), ("ynynynynny", 50.0), ("nnnnnn", 51.0), ("yyyyy", 50.0)]
)
def test_a_step_counts_as_answered_from_five_of_ten_on(answered: str, threshold: float) -> None:
    script = {51: iter("yyyyyyyyyy"), 50: iter(answered), 49: iter("n" * 10)}
    hunt = hunted(
        ThresholdSettings(method="relative_frequency", start=51.0),
        lambda intensity: (next(script[int(intensity)]) == "y", None),
    )
    assert hunt.estimate.threshold == threshold


def test_relative_frequency_counts_only_what_it_asked_for() -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(method="relative_frequency"))
    with pytest.raises(RefusalError, match="requested 35 %"):
        hunt.after(36.0, responded=True)
