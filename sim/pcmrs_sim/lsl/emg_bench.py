"""A subject without a cell: a muscle, and a coil whose pose lines of text set."""

from __future__ import annotations

import math
from functools import cached_property

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.spatial import Transform
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.muscle.muscle import Muscle, Stimulus
from pcmrs_sim.settings import MuscleSettings
from pcmrs_sim.tms.subject import Subject

USAGE = "coil <dx> <dy> <dz> <turn> (mm and degrees from the hot-spot), no_mep on|off, preactivation <uV>"
"""Syntax of the lines."""
SWITCH = {"on": True, "off": False}


class EmgBench:
    """The subject of a seed. The coil starts at the hot-spot.

    Args:
        settings: Settings of the electromyogram.
        seed: Seed of the subject, the noise and the variability.
        clock: Clock of the pulses and of changes of the muscle.

    Attributes:
        muscle: The muscle that answers the pulses.
    """

    def __init__(self, settings: MuscleSettings, seed: int, clock: Clock) -> None:
        self.muscle = Muscle(settings, lambda: self.subject, seed)
        self._seed = seed
        self._clock = clock
        self._hotspot_from_coil = Transform.identity()

    @cached_property
    def subject(self) -> Subject:
        """The subject under the coil."""
        subject = draw_subject("head", self._seed)
        assert subject is not None  # the head phantom always has one
        return subject

    def stimulate(self, number: int, intensity: float, time: float) -> Stimulus:
        """Give a pulse from the present pose of the coil, and return its effect.

        Args:
            number: Number of the pulse.
            intensity: Percent of the maximum stimulator output.
            time: Time of the pulse on the clock, s.
        """
        image_from_coil = self.subject.image_from_hotspot @ self._hotspot_from_coil
        return self.muscle.stimulate(number, time, image_from_coil, intensity)

    def execute(self, line: str) -> None:
        """Move the coil or change the muscle, as a line says.

        Args:
            line: A line of `USAGE`: offsets in mm along the axes of the hot-spot, turn in degrees about its +z, EMG in
                uV (rms).

        Raises:
            DeviceError: The line does not follow `USAGE`.
        """
        try:
            match line.split():
                case ["coil", *numbers]:
                    dx, dy, dz, turn = map(_finite, numbers)
                    offset = (dx * 1e-3, dy * 1e-3, dz * 1e-3)
                    self._hotspot_from_coil = Transform.from_rotvec(offset, (0.0, 0.0, math.radians(turn)))
                case ["no_mep", word]:
                    self.muscle.silent = SWITCH[word]
                case ["preactivation", microvolts]:
                    self.muscle.preactivate(abs(_finite(microvolts)) * 1e-6, self._clock.monotonic())
                case words:
                    raise ValueError(words)  # noqa: TRY301
        except (ValueError, KeyError):
            raise DeviceError(f"{line.strip()!r} is not understood; write one of: {USAGE}.", line=line) from None


def _finite(word: str) -> float:
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(word)
    return value
