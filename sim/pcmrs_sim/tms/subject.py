"""A simulated subject: the effect of a coil in any pose, and the muscle's response to it.

The effect of a pose is an *effective* intensity: the intensity with the same effect at the hot-spot. It is the
stimulator's intensity times the fraction of the field that reaches the target below the hot-spot, in the direction that
matters. The model gives the size of the effects; it is not a model of a brain.
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
"""Depth of the target, the motor cortex, below the scalp, m: Stokes et al., J. Neurophysiol. 94 (2005) 4520."""

HALF_DEPTH = 0.014
HALF_AREA = 15e-4
"""Field of a 70 mm figure-of-eight coil: additional depth at which half of it is left, m, and area of the cortex on
which it is at least half of its maximum, m^2. Deng, Lisanby, Peterchev, Brain Stimul. 6 (2013) 1. That depth means 5 %
per mm, which agrees with 3 % of the maximum output per mm at a threshold of 60 % (Stokes et al. 2005)."""

THRESHOLD_MEAN, THRESHOLD_TWICE, THRESHOLD_ONCE = 63.3, 7.3, 4.7
"""Threshold by the angle from the best orientation, percent: ``mean - twice cos(2 angle) - once cos(angle)``. Richter
et al., PLoS ONE 8 (2013) e60358, for a biphasic pulse on the foot's area."""

SPREAD = 0.008
REACH = 0.016
"""Hot-spots around the hand area: standard deviation along each axis, and largest distance, m. Two examiners find
hot-spots of one subject that are 10.3 mm apart (Sollmann et al., BMC Neurosci. 14 (2013) 94)."""

TURN_SPREAD = math.radians(18.3)
"""Standard deviation of the best orientation, rad: Richter et al. 2013."""

TURN_REACH = math.radians(45.0)
"""Largest angle between the best and the usual orientation, rad."""


@dataclass(frozen=True)
class Subject:
    """A simulated subject.

    Attributes:
        recruitment: Response of the muscle to an effective intensity.
        image_from_hotspot: Best pose of the coil: origin on the scalp, +z away from the head, +y away from the handle.
    """

    recruitment: Recruitment
    image_from_hotspot: Transform

    def effective(self, image_from_coil: Transform, intensity: float) -> float:
        """Return the intensity with the same effect at the hot-spot, in the unit of `intensity`.

        Of a tilted coil, only the component along the head counts, hence the cosine: a coil that is perpendicular to a
        conductor induces little in it (P. S. Tofts, Phys. Med. Biol. 35 (1990) 1119).

        Args:
            image_from_coil: True pose of the coil.
            intensity: Intensity of the stimulator, in any unit.
        """
        target_in_coil = image_from_coil.inverse() @ (self.image_from_hotspot @ np.array((0.0, 0.0, -DEPTH)))
        lateral_squared = float(target_in_coil[0] ** 2 + target_in_coil[1] ** 2)
        extra_depth = abs(float(target_in_coil[2])) - DEPTH
        field = float(2.0 ** -(math.pi * lateral_squared / HALF_AREA + extra_depth / HALF_DEPTH))
        cos_tilt = abs(float(self.image_from_hotspot.rotation[:, 2] @ image_from_coil.rotation[:, 2]))
        angle = heading(self.image_from_hotspot, image_from_coil)
        return intensity * field * cos_tilt * _orientation_factor(angle)

    def response(self, image_from_coil: Transform, intensity: float, rng: np.random.Generator) -> float:
        """Draw the peak-to-peak amplitude after one pulse from a pose, V.

        Args:
            image_from_coil: True pose of the coil.
            intensity: Percent of the maximum stimulator output.
            rng: Source of the variability.
        """
        return self.recruitment.sample(self.effective(image_from_coil, intensity), rng)


def draw(closest: NearestPoints, centre: Transform, rng: np.random.Generator) -> Subject:
    """Draw a subject of the published population.

    Args:
        closest: Returns the nearest points of the scalp, and the normals there.
        centre: Usual pose over the hand area, ``image_from_coil``, of `pcmrs.tms.scalp.hand_area`.
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


def _orientation_factor(angle: float) -> float:
    """Return the fraction of the intensity that counts at an angle, rad, from the best orientation.

    It is the lowest threshold over the threshold at this angle (Richter et al. 2013).
    """
    lowest = THRESHOLD_MEAN - THRESHOLD_TWICE - THRESHOLD_ONCE
    return lowest / (THRESHOLD_MEAN - THRESHOLD_TWICE * math.cos(2.0 * angle) - THRESHOLD_ONCE * math.cos(angle))
