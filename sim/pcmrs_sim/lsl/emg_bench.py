"""A subject in a chair: a muscle without a cell, and a coil that is held where somebody says."""

from __future__ import annotations

import math
from functools import cached_property

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError
from pcmrs.spatial import Transform
from pcmrs_sim.muscle.muscle import Muscle, Stimulus
from pcmrs_sim.muscle.subject import draw_subject
from pcmrs_sim.settings import MuscleSettings
from pcmrs_sim.tms.subject import Subject

USAGE = "coil <dx> <dy> <dz> <turn> (mm and degrees from the hot-spot), no_mep on|off, preactivation <uV>"
SWITCH = {"on": True, "off": False}


class EmgBench:
    """A subject of a seed, with the coil at the hot-spot until told otherwise.

    Args:
        settings: The electromyogram.
        seed: Who it is, and where noise and variability come from.
        clock: Lines that change something do so at once.

    Attributes:
        muscle: Answers the pulses.
    """

    def __init__(self, settings: MuscleSettings, seed: int, clock: Clock) -> None:
        self.muscle = Muscle(settings, lambda: self.subject, seed)
        self._seed = seed
        self._clock = clock
        self._hotspot_from_coil = Transform.identity()

    @cached_property
    def subject(self) -> Subject:
        """Who sits there."""
        subject = draw_subject("head", self._seed)
        assert subject is not None  # a head has one
        return subject

    def stimulate(self, number: int, intensity: float, time: float) -> Stimulus:
        """A pulse at `time` of the clock, s, with `intensity` in percent, from where the coil is held."""
        pose = self.subject.image_from_hotspot @ self._hotspot_from_coil
        return self.muscle.stimulate(number, time, pose, intensity)

    def tell(self, line: str) -> None:
        """Does what a line says: see `USAGE`.

        Raises:
            DeviceError: It says nothing of that kind.
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
