"""The plan on one page that has not been sent yet. Numbers only: it knows neither page nor daemon."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.messages.setup import LandmarkShown
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.grid import rows_on_scalp
from pcmrs.tms.scalp import along_scalp, on_scalp, turned
from pcmrs.workflows.femoroplasty import guide_pose

Kind = Literal["landmarks", "tool_pose", "grid", "trajectory"]
"""Kind of plan, by the registered name of its payload."""

STEP, TURN = 0.001, math.radians(5.0)
"""Step of a key along the surface, m, and its turn about the tool's axis, rad."""
MOVES = {"ArrowRight": (STEP, 0.0), "ArrowLeft": (-STEP, 0.0), "ArrowUp": (0.0, STEP), "ArrowDown": (0.0, -STEP)}
TURNS = {"[": TURN, "]": -TURN}

NEAR, TYPICAL = 0.030, 0.006
"""Largest distance of a landmark from the surface, and of half of them, m: landmarks farther away are of another image
or space. A surface may lack a nose; on a head that is turned round, no single landmark is far off."""
_MISREAD = {
    "in the other space, LPS or RAS": np.diag((-1.0, -1.0, 1.0)),
    "mirrored, with left and right exchanged": np.diag((-1.0, 1.0, 1.0)),
    "in a unit 1000 times as large": np.eye(3) * 1e3,
    "in a unit 1000 times smaller": np.eye(3) * 1e-3,
}
"""Mistakes in the reading of a mesh, and what corrects the landmarks, (3, 3): they then fit the mesh as it was read."""
DEEPEST = 0.080
"""Largest depth of a target for a coil below the scalp, m."""


@dataclass
class Draft:
    """Points and poses in the image, m.

    Attributes:
        surface: Surface to plan on; None if the cell has none.
        cortex: Surface with the targets; None unless it was loaded.
        pose: ``image_from_coil`` of the tool.
        target: Target in the cortex.
        entry: Point at which a drill enters the bone.
        end: Planned end of the drilling.
    """

    surface: TriangleSurface | None = None
    cortex: TriangleSurface | None = None
    landmarks: list[LandmarkShown] = field(default_factory=list)
    pose: Transform | None = None
    target: Floats | None = None
    grid: tuple[Transform, ...] = ()
    entry: Floats | None = None
    end: Floats | None = None

    def add_landmark(self, point: Floats, name: str = "") -> None:
        """Add a landmark.

        Args:
            point: Its position, m, (3,).
            name: Its name; by default the next free number.

        Raises:
            GeometryError: The name is used already.
        """
        taken = {each.name for each in self.landmarks}
        number = next(number for number in range(1, len(taken) + 2) if f"landmark_{number}" not in taken)
        name = name.strip() or f"landmark_{number}"
        if name in taken:
            raise GeometryError(f"There is a landmark {name} already; give another name.", name=name)
        x, y, z = point.tolist()
        self.landmarks.append(LandmarkShown(name=name, planned=(x, y, z)))

    def load_landmarks(self, names: Sequence[str], points: Floats) -> None:
        """Replace the landmarks by those of a file.

        Args:
            names: Their names.
            points: Their positions, m, (N, 3).

        Raises:
            GeometryError: They are not at the surface, or two have one name: then none is taken. If the mesh seems to
                have been read in a wrong unit, space or handedness, the text says so.
        """
        try:
            self._check_at_surface(names, points)
        except GeometryError as error:
            mistake = self._mistake(names, points)
            if mistake is None:
                raise
            text = f"{error.text} The landmarks fit a mesh that was read {mistake}: check the files of both."
            raise GeometryError(text, **error.fields) from None
        found = Draft()
        for name, point in zip(names, points, strict=True):
            found.add_landmark(point, name)
        self.landmarks = found.landmarks

    def aim(self, target: Floats, direction: Floats | None = None) -> None:
        """Place the tool on the surface over a target in the cortex.

        Args:
            target: Target, m, (3,).
            direction: Direction of the projection, (3,); None for the nearest point of the surface.

        Raises:
            GeometryError: The target is too far from the surface, or the surface is not met in that direction.
        """
        self._check_near(["target"], target[None], DEEPEST)
        surface = self._surface()
        if direction is None:
            point = surface.closest(target[None])[0][0]
        else:
            point = surface.exit_point(target, direction)
            if point is None:
                text = "From the target in this direction there is no surface; reverse the direction."
                raise GeometryError(text, direction=direction.tolist())
        self.place(point)
        self.target = target

    @property
    def depth(self) -> float | None:
        """The distance of the target from the tool, m; None without both."""
        if self.target is None or self.pose is None:
            return None
        return float(np.linalg.norm(self.pose.translation - self.target))

    def replace_surface(self, surface: TriangleSurface | None) -> None:
        """Plan on another surface.

        Everything that was placed on the old one is dropped. Landmarks are points of the image and stay.
        """
        self.surface, self.pose, self.target, self.grid = surface, None, None, ()

    def normal_at(self, target: Floats) -> Floats:
        """Return the outward normal of the cortex nearest to a target, (3,).

        Raises:
            GeometryError: There is no cortex.
        """
        if self.cortex is None:
            raise GeometryError("Along the normal needs a surface of the cortex, or the direction as numbers.")
        normal: Floats = self.cortex.closest(target[None])[1][0]
        return normal

    def place(self, point: Floats) -> None:
        """Place the tool on the surface at a point, m, (3,), without turning its handle.

        Raises:
            GeometryError: There is no surface.
        """
        surface = self._surface()
        z = surface.closest(point[None])[1][0]
        before = np.eye(3) if self.pose is None else self.pose.rotation
        y = before[:, 1] - (before[:, 1] @ z) * z
        if np.linalg.norm(y) < 1e-3:
            y = np.cross(z, before[:, 0])
        y /= np.linalg.norm(y)
        self.pose = on_scalp(surface.closest, Transform(np.column_stack((np.cross(y, z), y, z)), point))

    def move(self, key: str) -> None:
        """Move the tool along the surface, or turn it; other keys have no effect.

        Raises:
            GeometryError: There is no surface.
        """
        if self.pose is None:
            return
        if key in TURNS:
            self.pose = turned(self.pose, TURNS[key])
        elif key in MOVES:
            (self.pose,) = along_scalp(self._surface().closest, self.pose, [MOVES[key]])

    def lay_grid(self, spacing: float, rows: int, columns: int) -> None:
        """Make a grid around the tool.

        Args:
            spacing: Distance of neighbouring points, m.
            rows: Number of rows.
            columns: Number of columns.

        Raises:
            GeometryError: The tool is not placed, there is no surface, or the grid is not possible on it.
        """
        if self.pose is None:
            raise GeometryError("The grid lies around the tool; place it first.")
        self.grid = rows_on_scalp(self._surface().closest, self.pose, spacing, rows, columns)

    @property
    def guide(self) -> Transform | None:
        """``image_from_coil`` of a guide at the entry of the trajectory; None until it has a direction."""
        if self.entry is None or self.end is None or np.array_equal(self.entry, self.end):
            return None
        return guide_pose(self.entry, self.end)

    def arguments(self, kind: Kind) -> dict[str, Any] | None:
        """Return the arguments of the operation that takes the plan; None while it is incomplete."""
        match kind:
            case "landmarks" if self.landmarks:
                return {"landmarks": [{"name": each.name, "position": list(each.planned)} for each in self.landmarks]}
            case "tool_pose" if self.pose is not None:
                return as_arguments(self.pose)
            case "grid" if self.grid:
                return {"poses": [as_arguments(pose) for pose in self.grid]}
            case "trajectory" if self.entry is not None and self.end is not None:
                return {"entry": self.entry.tolist(), "target": self.end.tolist()}
        return None

    def _surface(self) -> TriangleSurface:
        if self.surface is None:
            raise GeometryError("There is no surface to plan on: load one, or set procedure.body.surface.")
        return self.surface

    def _mistake(self, names: Sequence[str], points: Floats) -> str | None:
        """Return the mistake in the reading of the mesh that explains where landmarks (N, 3) are; None if none does."""
        for mistake, correction in _MISREAD.items():
            try:
                self._check_at_surface(names, points @ correction)
            except GeometryError:
                continue
            return mistake
        return None

    def _check_at_surface(self, names: Sequence[str], points: Floats) -> None:
        """Check that landmarks (N, 3) are at the surface.

        Raises:
            GeometryError: One is farther than `NEAR`, or half of them are farther than `TYPICAL`.
        """
        middle = float(np.median(self._check_near(names, points, NEAR)))
        if not middle <= TYPICAL:
            text = (
                f"Half of the landmarks are {middle * 1000:.0f} mm or more from the surface; the limit is "
                f"{TYPICAL * 1000:g} mm. Does the file declare the right space, LPS or RAS, and is it of this image?"
            )
            raise GeometryError(text, value=middle, limit=TYPICAL)

    def _check_near(self, names: Sequence[str], points: Floats, limit: float) -> Floats:
        """Return the distances of points (N, 3) from the surface, m, (N,).

        Raises:
            GeometryError: One is farther than the limit.
        """
        nearest, _ = self._surface().closest(points)
        distances: Floats = np.linalg.norm(nearest - points, axis=1)
        worst = int(distances.argmax())
        if not distances[worst] <= limit:
            text = (
                f"{names[worst]} is {distances[worst] * 1000:.0f} mm from the surface; the limit is {limit * 1000:g} "
                "mm. Is it a point of this image, in its space (RAS or LPS) and unit?"
            )
            raise GeometryError(text, name=names[worst], value=float(distances[worst]), limit=limit)
        return distances


def as_arguments(pose: Transform) -> dict[str, Any]:
    """Return a pose as arguments of an operation."""
    return {"position": pose.translation.tolist(), "quat_xyzw": pose.quat_xyzw.tolist()}


def typed_point(text: str | None) -> Floats:
    """Return three typed numbers, mm, as m, (3,).

    Raises:
        GeometryError: The text is not three numbers.
    """
    return typed_numbers(text) / 1000.0


def typed_numbers(text: str | None) -> Floats:
    """Return three typed numbers, (3,).

    Raises:
        GeometryError: The text is not three numbers.
    """
    try:
        numbers = [float(word) for word in (text or "").replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        raise GeometryError(f"{text!r} is not three numbers such as 4 -12 143.")
    return np.array(numbers)
