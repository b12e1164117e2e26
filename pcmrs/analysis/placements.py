"""Errors of placements as defined in the paper, and the mean, standard deviation and maximum of a series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.formats.pose_file import Placement
from pcmrs.spatial import Floats, Transform, rotation_angle

__all__ = ["PlacementError", "PlacementTrial", "Summary", "placement_error", "summarize"]


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of a series, in its unit.

    Attributes:
        sd: Standard deviation of a sample (n - 1); None for a single value.
    """

    mean: float
    sd: float | None
    max: float


def summarize(values: npt.ArrayLike) -> Summary:
    """Return the summary of one or more values (N,)."""
    series = np.asarray(values, dtype=float)
    sd = float(series.std(ddof=1)) if len(series) > 1 else None
    return Summary(float(series.mean()), sd, float(series.max()))


@dataclass(frozen=True, eq=False, slots=True)
class PlacementError:
    """Error of a measured pose against the planned one.

    Attributes:
        vector: Translation error in the measured tool's axes, m, (3,).
        angle: Rotation error, in [0, pi] rad.
    """

    vector: Floats
    angle: float

    @property
    def distance(self) -> float:
        """Length of the vector, m."""
        return float(np.linalg.norm(self.vector))


def placement_error(planned: Transform, measured: Transform, standoff: float) -> PlacementError:
    """Return the error ``R_m^T (t_m - t_p) - s e_z`` and the angle of ``R_p^T R_m``.

    Liu, Kheradmand, Armand, Toward Process Controlled Medical Robotic System (2023).

    Args:
        planned: Planned pose, ``image_from_tool``.
        measured: Measured pose, ``image_from_tool``.
        standoff: Distance s along the tool's z axis at which the tool was to stop before the planned pose, m.
    """
    tool_from_plan = measured.rotation.T @ (measured.translation - planned.translation)
    return PlacementError(tool_from_plan - np.array((0.0, 0.0, standoff)), rotation_angle(planned, measured))


@dataclass(frozen=True, eq=False, slots=True)
class PlacementTrial:
    """A placement with its standoff.

    Attributes:
        placement: Planned and measured pose.
        standoff: Distance along the tool's z axis at which the tool was to stop before the planned pose, m.
    """

    placement: Placement
    standoff: float

    @property
    def error(self) -> PlacementError:
        """Error of the placement without its standoff."""
        return placement_error(self.placement.planned, self.placement.measured, self.standoff)
