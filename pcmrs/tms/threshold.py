"""Hunt for a motor threshold pulse by pulse, with either method."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Self

import msgspec

from pcmrs.errors import RefusalError
from pcmrs.tms import _likelihood, _rossini_rothwell
from pcmrs.tms.settings import Estimate, EstimatorState, Pulse, ThresholdSettings

__all__ = ["MotorThresholdEstimator"]

METHODS: dict[str, Callable[[ThresholdSettings, tuple[Pulse, ...]], EstimatorState]] = {
    "ml": _likelihood.estimator_state,
    "relative_frequency": _rossini_rothwell.estimator_state,
}


class MotorThresholdEstimator(msgspec.Struct, frozen=True):
    """State of a hunt: its settings, and the pulses with their responses.

    It holds everything that the hunt depends on, so that it can be journalled and replayed. Start with ``hunt =
    MotorThresholdEstimator.begin(settings)`` and continue with ``hunt = hunt.after(hunt.next_intensity(), responded)``
    until `finished`. `next_intensity` refuses if no threshold can be found.

    Attributes:
        settings: Settings of the hunt.
        pulses: Pulses that count. A pulse whose response cannot be judged is repeated and is not among them.
    """

    settings: ThresholdSettings
    pulses: tuple[Pulse, ...] = ()

    @classmethod
    def begin(cls, settings: ThresholdSettings) -> Self:
        """Return a hunt without pulses."""
        return cls(settings)

    def next_intensity(self) -> float:
        """Return the intensity of the next pulse.

        It is whole percent of the maximum stimulator output and never above the ceiling.

        Raises:
            RefusalError: ``hunt_finished``, or no threshold can be found: ``above_ceiling``, ``below_floor`` or
                ``not_converged``.
        """
        state = self._state
        if state.finished:
            raise RefusalError(
                "hunt_finished",
                f"The threshold is known after {len(self.pulses)} pulses: {state.estimate.threshold:g} %. Start a "
                "new hunt to measure it again.",
                pulses=len(self.pulses),
            )
        self._refuse_if_no_threshold()
        return state.intensity

    def after(self, intensity: float, responded: bool, amplitude: float | None = None) -> Self:
        """Return the hunt with one more pulse.

        Args:
            intensity: Intensity of the pulse, percent of the maximum stimulator output.
            responded: True if its response was at least `ThresholdSettings.response_uv`.
            amplitude: Peak-to-peak amplitude, V. With it, maximum likelihood needs fewer pulses.

        Raises:
            RefusalError: ``bad_intensity``: the intensity is invalid, above the ceiling, or not the one that this
                method requested; ``bad_amplitude``: the amplitude is invalid or contradicts `responded`; otherwise as
                `next_intensity`.
        """
        requested = self.next_intensity()
        ceiling = self.settings.ceiling
        if not 0.0 < intensity <= ceiling:  # true for nan, too
            raise RefusalError(
                "bad_intensity",
                f"A pulse of {intensity:g} % cannot count: the ceiling is {ceiling:g} %. Give one of {requested:g} %.",
                intensity=intensity,
                ceiling=ceiling,
            )
        if self.settings.method == "relative_frequency" and intensity != requested:
            raise RefusalError(
                "bad_intensity",
                f"A pulse of {intensity:g} % cannot count for relative frequency, which requested {requested:g} %.",
                intensity=intensity,
                asked=requested,
            )
        self._refuse_contradiction(responded, amplitude)
        return type(self)(self.settings, (*self.pulses, Pulse(float(intensity), responded, amplitude)))

    @property
    def estimate(self) -> Estimate:
        """Threshold; until the hunt has finished, the best present estimate."""
        return self._state.estimate

    @property
    def finished(self) -> bool:
        """True if the threshold is known well enough and lies between floor and ceiling."""
        return self._state.finished

    @property
    def refusal(self) -> str | None:
        """Code of the reason why no threshold can be found; None while one may be found.

        `next_intensity` raises it.
        """
        state = self._state
        exhausted = not state.finished and len(self.pulses) >= self.settings.max_pulses
        return state.refusal or ("not_converged" if exhausted else None)

    @property
    def _state(self) -> EstimatorState:
        return METHODS[self.settings.method](self.settings, self.pulses)

    def _refuse_if_no_threshold(self) -> None:
        code = self.refusal
        if code is None:
            return
        settings, pulses = self.settings, len(self.pulses)
        why = {
            "above_ceiling": f"the muscle does not respond up to the ceiling of {settings.ceiling:g} %. Check "
            "electrodes, coil and hot-spot; the ceiling is set by the operator alone.",
            "below_floor": f"responses continue below {settings.floor:g} %. Check for muscle activity and artefacts.",
            "not_converged": f"no more than {settings.max_pulses} may be given. Check that the muscle is at rest and "
            "the coil at its place, and begin again.",
        }[code]
        raise RefusalError(code, f"No threshold after {pulses} pulses: {why}", pulses=pulses)

    def _refuse_contradiction(self, responded: bool, amplitude: float | None) -> None:
        """Raise `RefusalError` if an amplitude is invalid or contradicts the response."""
        if amplitude is None:
            return
        least_uv = self.settings.response_uv
        if not (math.isfinite(amplitude) and amplitude >= 0.0):
            raise RefusalError("bad_amplitude", f"{amplitude} V is not an amplitude.", amplitude=amplitude)
        if responded != (amplitude * 1e6 >= least_uv):
            raise RefusalError(
                "bad_amplitude",
                f"{amplitude * 1e6:g} uV {'is' if responded else 'is not'} reported as a response, which begins at "
                f"{least_uv:g} uV. Use the same limit for amplitudes and for the hunt.",
                amplitude=amplitude,
                response_uv=least_uv,
            )
