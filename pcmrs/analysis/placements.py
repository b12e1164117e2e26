"""Errors of recorded placements, as the paper has them.

Mean, standard deviation and maximum of a series.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.formats.pose_file import Placement
from pcmrs.spatial import Floats, Transform, rotation_angle


@dataclass(frozen=True, slots=True)
class Summary:
    """What a series comes to, in its own unit.

    Attributes:
        sd: Standard deviation of a sample (n - 1); None for one value, which has none.
    """

    mean: float
    sd: float | None
    max: float


def summarize(values: npt.ArrayLike) -> Summary:
    """Of one or more values (N,)."""
    series = np.asarray(values, dtype=float)
    sd = float(series.std(ddof=1)) if len(series) > 1 else None
    return Summary(float(series.mean()), sd, float(series.max()))


@dataclass(frozen=True, eq=False, slots=True)
class PlacementError:
    """How far a measured pose is from the planned one.

    Attributes:
        vector: Of the translation, in the measured tool's axes, m, (3,).
        angle: Of the rotation, in [0, pi] rad.
    """

    vector: Floats
    angle: float

    @property
    def distance(self) -> float:
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))


def placement_error(planned: Transform, measured: Transform, standoff: float) -> PlacementError:
    """``R_m^T (t_m - t_p) - s e_z`` and the angle of ``R_p^T R_m``.

    Liu, Kheradmand, Armand, Toward Process Controlled Medical Robotic System (2023).

    Args:
        planned: ``image_from_tool``.
        measured: ``image_from_tool``.
        standoff: Distance s along the tool's z axis at which the tool was to stand before the planned pose, m.
    """
    tool_from_plan = measured.rotation.T @ (measured.translation - planned.translation)
    return PlacementError(tool_from_plan - np.array((0.0, 0.0, standoff)), rotation_angle(planned, measured))


@dataclass(frozen=True, eq=False, slots=True)
class PlacementTrial:
    """A placement on record.

    Attributes:
        placement: The planned and the measured pose.
        standoff: How far along the tool's z axis it was to end before the planned pose, m.
    """

    placement: Placement
    standoff: float

    @property
    def error(self) -> PlacementError:
        """Of the placement, its standoff taken off."""
        return placement_error(self.placement.planned, self.placement.measured, self.standoff)
