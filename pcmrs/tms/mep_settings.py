"""What a motor evoked potential is told from."""

from __future__ import annotations

from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class MepSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a response is looked for, and when a measurement cannot be used; for a muscle of the hand at rest.

    Attributes:
        window_start: A response comes no earlier after the pulse, s;
        window_end: and no later.
        baseline_start: The muscle is judged at rest from here, s before the pulse: negative;
        baseline_end: until here.
        threshold_uv: Least peak-to-peak amplitude of a response: Rossini et al., Clin. Neurophysiol. 126 (2015) 1071.
        preactivation_uv: A muscle with more root mean square activity than this before the pulse is not at rest: the
            usual limit, which is not strict.
        artefact_uv: If the mean of the signal is still this far from its baseline just before the window, where no
            response can be yet, the stimulus reaches into the window.
        artefact_time: How long before the window that mean is taken, s.
        mains_hz: Frequency of the mains, whose hum is taken out; 0 for none.

    Raises:
        ValueError: The baseline does not end before the pulse, or the window does not begin after it.
    """

    window_start: Positive = 0.015
    window_end: Positive = 0.050
    baseline_start: float = -0.105
    baseline_end: float = -0.005
    threshold_uv: Positive = 50.0
    preactivation_uv: Positive = 10.0
    artefact_uv: Positive = 15.0
    artefact_time: Positive = 0.003
    mains_hz: Annotated[float, msgspec.Meta(ge=0.0, le=70.0)] = 50.0

    def __post_init__(self) -> None:
        if not self.baseline_start < self.baseline_end <= 0.0:
            raise ValueError("baseline_start must be before baseline_end, and that not after the pulse")
        if not self.artefact_time <= self.window_start < self.window_end:
            raise ValueError("window_start must be before window_end, and artefact_time fit between pulse and window")
