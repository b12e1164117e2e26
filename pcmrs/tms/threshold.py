"""The hunt for a motor threshold, pulse by pulse, whatever the method."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Self

import msgspec

from pcmrs.errors import RefusalError
from pcmrs.tms import likelihood, rossini_rothwell
from pcmrs.tms.settings import Estimate, EstimatorState, Pulse, ThresholdSettings

METHODS: dict[str, Callable[[ThresholdSettings, tuple[Pulse, ...]], EstimatorState]] = {
    "ml": likelihood.standing,
    "relative_frequency": rossini_rothwell.standing,
}


class MotorThresholdEstimator(msgspec.Struct, frozen=True):
    """What has been asked and answered; nothing else counts, so that it can be journalled and replayed.

    ``hunt = ThresholdHunt.begin(settings)``, then ``hunt = hunt.after(hunt.next_intensity(), responded)`` until
    `finished`; `next_intensity` refuses when there is no threshold to be found.

    Attributes:
        pulses: That count; a pulse whose response cannot be judged is given again and is not among them.
    """

    settings: ThresholdSettings
    pulses: tuple[Pulse, ...] = ()

    @classmethod
    def begin(cls, settings: ThresholdSettings) -> Self:
        """A hunt without pulses."""
        return cls(settings)

    def next_intensity(self) -> float:
        """Of the next pulse, percent of the maximum stimulator output, a whole number and never above the ceiling.

        Raises:
            RefusalError: ``hunt_finished``; or there is no threshold to be found: ``above_ceiling``, ``below_floor`` or
                ``not_converged``.
        """
        standing = self._standing
        if standing.finished:
            raise RefusalError(
                "hunt_finished",
                f"The threshold is known after {len(self.pulses)} pulses: {standing.estimate.threshold:g} %. Begin a "
                "new hunt to measure it again.",
                pulses=len(self.pulses),
            )
        self._refuse_hopeless()
        return standing.intensity

    def after(self, intensity: float, responded: bool, amplitude: float | None = None) -> Self:
        """The hunt with one pulse more.

        Args:
            intensity: That was given, percent of the maximum stimulator output.
            responded: Whether its response was at least `ThresholdSettings.response_uv`.
            amplitude: Peak-to-peak amplitude, V; with it, maximum likelihood needs fewer pulses.

        Raises:
            RefusalError: ``bad_intensity``: no intensity, above the ceiling, or not what this method asked for;
                ``bad_amplitude``: no amplitude, or it contradicts `responded`; else as `next_intensity`.
        """
        asked = self.next_intensity()
        ceiling = self.settings.ceiling
        if not 0.0 < intensity <= ceiling:  # nan is neither
            raise RefusalError(
                "bad_intensity",
                f"A pulse of {intensity:g} % cannot count: the ceiling is {ceiling:g} %. Give one of {asked:g} %.",
                intensity=intensity,
                ceiling=ceiling,
            )
        if self.settings.method == "relative_frequency" and intensity != asked:
            raise RefusalError(
                "bad_intensity",
                f"A pulse of {intensity:g} % cannot count for relative frequency, which asked for {asked:g} %.",
                intensity=intensity,
                asked=asked,
            )
        self._refuse_contradiction(responded, amplitude)
        return type(self)(self.settings, (*self.pulses, Pulse(float(intensity), responded, amplitude)))

    @property
    def estimate(self) -> Estimate:
        """The threshold; until the hunt has finished, what is best at the moment."""
        return self._standing.estimate

    @property
    def finished(self) -> bool:
        """Whether the threshold is known well enough, within ceiling and floor."""
        return self._standing.finished

    @property
    def refusal(self) -> str | None:
        """Code of why there is no threshold to be found, as `next_intensity` raises it; None while there may be one."""
        standing = self._standing
        exhausted = not standing.finished and len(self.pulses) >= self.settings.max_pulses
        return standing.refusal or ("not_converged" if exhausted else None)

    @property
    def _standing(self) -> EstimatorState:
        return METHODS[self.settings.method](self.settings, self.pulses)

    def _refuse_hopeless(self) -> None:
        code = self.refusal
        if code is None:
            return
        settings, pulses = self.settings, len(self.pulses)
        why = {
            "above_ceiling": f"the muscle does not respond up to the ceiling of {settings.ceiling:g} %. Check "
            "electrodes, coil and hot-spot; the ceiling is set by the operator alone.",
            "below_floor": f"responses go on below {settings.floor:g} %. Check for muscle activity and artefacts.",
            "not_converged": f"no more than {settings.max_pulses} may be given. Check that the muscle is at rest and "
            "the coil at its place, and begin again.",
        }[code]
        raise RefusalError(code, f"No threshold after {pulses} pulses: {why}", pulses=pulses)

    def _refuse_contradiction(self, responded: bool, amplitude: float | None) -> None:
        if amplitude is None:
            return
        least_uv = self.settings.response_uv
        if not (math.isfinite(amplitude) and amplitude >= 0.0):
            raise RefusalError("bad_amplitude", f"{amplitude} V is no amplitude.", amplitude=amplitude)
        if responded != (amplitude * 1e6 >= least_uv):
            raise RefusalError(
                "bad_amplitude",
                f"{amplitude * 1e6:g} uV {'is' if responded else 'is not'} said to be a response, which begins at "
                f"{least_uv:g} uV. Judge amplitudes and hunt with the same limit.",
                amplitude=amplitude,
                response_uv=least_uv,
            )
