"""A simulated subject: how well a coil stimulates the muscle from any pose, and the response to it.

What a pose achieves is told as an *effective* intensity, which would do the same at the hot-spot: the stimulus times
the share of the field that reaches the target below the hot-spot in the direction that matters. It is a model of the
size of the effects, not of anybody's brain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pcmrs.spatial import Transform
from pcmrs.tms.scalp import NearestPoints, along_scalp, heading, turned
from pcmrs_sim.tms import recruitment
from pcmrs_sim.tms.recruitment import Recruitment

DEPTH = 0.015
"""Of the target below the scalp, m: the motor cortex; Stokes et al., J. Neurophysiol. 94 (2005) 4520."""

HALF_DEPTH = 0.014
HALF_AREA = 15e-4
"""Of a 70 mm figure-of-eight coil: further depth at which half of the field is left, m, and area of the cortex on
which it is at least half of its largest, m^2. Deng, Lisanby, Peterchev, Brain Stimul. 6 (2013) 1. The depth is 5 %
per mm, as much as the 3 % of the maximum output per mm at a threshold of 60 % (Stokes et al. 2005)."""

THRESHOLD_MEAN, THRESHOLD_TWICE, THRESHOLD_ONCE = 63.3, 7.3, 4.7
"""Threshold over the angle from the best orientation, percent: ``mean - twice cos(2 angle) - once cos(angle)``; Richter
et al., PLoS ONE 8 (2013) e60358, a biphasic pulse on the foot's area."""

SPREAD = 0.008
REACH = 0.016
"""Hot-spots around the hand area: standard deviation along each axis, and farthest, m. Those that two examiners find
of one subject are 10.3 mm apart (Sollmann et al., BMC Neurosci. 14 (2013) 94)."""

TURN_SPREAD = math.radians(18.3)
"""Of the best orientation, standard deviation: Richter et al. 2013."""

TURN_REACH = math.radians(45.0)
"""Best orientations are within this of the usual one."""


@dataclass(frozen=True)
class Subject:
    """A simulated subject.

    Attributes:
        recruitment: What the muscle answers to an effective intensity.
        image_from_hotspot: Best pose of the coil: on the scalp, +z away from the head, +y away from the handle.
    """

    recruitment: Recruitment
    image_from_hotspot: Transform

    def effective(self, image_from_coil: Transform, intensity: float) -> float:
        """Intensity that would do the same at the hot-spot, in the unit of `intensity`.

        Of a tilted coil only the part along the head counts, the cosine: what stands upright on a conductor induces
        little in it (P. S. Tofts, Phys. Med. Biol. 35 (1990) 1119).
        """
        target = image_from_coil.inverse() @ (self.image_from_hotspot @ np.array((0.0, 0.0, -DEPTH)))
        aside = float(target[0] ** 2 + target[1] ** 2)
        deeper = abs(float(target[2])) - DEPTH
        field = float(2.0 ** -(math.pi * aside / HALF_AREA + deeper / HALF_DEPTH))
        upright = abs(float(self.image_from_hotspot.rotation[:, 2] @ image_from_coil.rotation[:, 2]))
        return intensity * field * upright * _direction(heading(self.image_from_hotspot, image_from_coil))

    def response(self, image_from_coil: Transform, intensity: float, rng: np.random.Generator) -> float:
        """Peak-to-peak amplitude after one pulse from a pose, V.

        Args:
            image_from_coil: The coil, as it is.
            intensity: Percent of the maximum stimulator output.
            rng: Source of the variability.
        """
        return self.recruitment.sample(self.effective(image_from_coil, intensity), rng)


def draw(closest: NearestPoints, centre: Transform, rng: np.random.Generator) -> Subject:
    """A random subject of the published population.

    Args:
        closest: The scalp.
        centre: Usual pose over the hand area, as `pcmrs.tms.scalp.hand_area` gives it.
        rng: Source of the differences between subjects.
    """
    offset = rng.normal(0.0, SPREAD, 2)
    while np.linalg.norm(offset) > REACH:
        offset = rng.normal(0.0, SPREAD, 2)
    turn = rng.normal(0.0, TURN_SPREAD)
    while abs(turn) > TURN_REACH:
        turn = rng.normal(0.0, TURN_SPREAD)
    (hotspot,) = along_scalp(closest, centre, offset[None])
    return Subject(recruitment.draw(rng), turned(hotspot, turn))


def _direction(angle: float) -> float:
    """Share of the intensity that counts at an angle from the best orientation: the threshold there, inverted."""
    lowest = THRESHOLD_MEAN - THRESHOLD_TWICE - THRESHOLD_ONCE
    return lowest / (THRESHOLD_MEAN - THRESHOLD_TWICE * math.cos(2.0 * angle) - THRESHOLD_ONCE * math.cos(angle))
