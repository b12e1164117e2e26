"""Map of a hot-spot search on the head: expected amplitudes, pulses, and hot-spot.

It is an orthographic view of the shaded skin, drawn triangle by triangle, with the map as a separate mesh on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pcmrs.analysis.plots import ORANGE, new_figure
from pcmrs.formats.mesh import Mesh
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import as_transform, heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SKIN = np.array((0.87, 0.84, 0.81))
LIGHT = np.array((-0.35, 0.45, 0.82))
"""Direction to the light in the view: right, up and towards the viewer."""

AMBIENT = 0.35
COLOURS = "viridis"
LEAST_UV = 10.0
"""Amplitude of the darkest colour, µV: the noise of an electromyogram."""

CIRCLES, SPOKES = 14, 48
"""Circles and points per circle of the map's mesh."""

VIEW = (0.75, 0.45, 0.5)
"""Direction to the viewer: the side of the map (x), a little to the front and above."""

MARGIN_MM = 9.0
ARROW_MM = 9.0


def hotspot_figure(mesh: Mesh, search: HotspotSearch, title: str, truth: Transform | None = None) -> Figure:
    """Return the head with the map, and the map from straight above with all pulses.

    Args:
        mesh: Surface of the head in the image, m.
        search: Search with at least one pulse.
        title: Title of the figure.
        truth: ``image_from_coil`` of the true hot-spot; None if it is unknown.
    """
    figure = new_figure(width=11.0, height=5.2)
    figure.suptitle(title)
    head, near = figure.subplots(1, 2)
    draw_head(head, mesh, search)
    colours = draw_map(near, mesh, search, truth)
    figure.colorbar(colours, ax=near, label="expected peak-to-peak amplitude, µV")
    figure.legend(*near.get_legend_handles_labels(), loc="outside lower center", ncols=4, facecolor="lightgray")
    return figure


def draw_head(axes: Axes, mesh: Mesh, search: HotspotSearch) -> None:
    """Draw the whole head from the side of the map.

    Args:
        axes: Axes to be drawn into.
        mesh: Surface of the head in the image, m.
        search: Search with at least one pulse.
    """
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
    side = 1.0 if search.places[0].position[0] >= middle[0] else -1.0
    view = _looking_from(np.array((side * VIEW[0], *VIEW[1:])), middle)
    _draw_skin(axes, mesh, view)
    _draw_expected(axes, search, view)
    _draw_directions(axes, view, 1e3 * float(np.ptp(mesh.vertices, axis=0).max()))
    axes.set_axis_off()
    axes.set_aspect("equal")


def draw_map(axes: Axes, mesh: Mesh, search: HotspotSearch, truth: Transform | None = None) -> Any:
    """Draw the map from straight above its centre, +y of the coil upwards.

    Args:
        axes: Axes to be drawn into.
        mesh: Surface of the head in the image, m.
        search: Search with at least one pulse.
        truth: ``image_from_coil`` of the true hot-spot; None if it is unknown.

    Returns:
        The coloured mesh, for a colour bar.
    """
    view = as_transform(search.places[0]).inverse()
    _draw_skin(axes, mesh, view)
    colours = _draw_expected(axes, search, view)
    _draw_pulses(axes, search, view)
    if search.responded:
        _draw_coil(axes, view @ as_transform(search.estimate.image_from_coil), "white", "o", "estimate")
    if truth is not None:
        _draw_coil(axes, view @ truth, ORANGE, "*", "true hot-spot")
    half = search.settings.spacing_mm * search.settings.rings + MARGIN_MM
    axes.set(
        xlim=(-half, half), ylim=(-half, half), xlabel="along x of the coil at the centre, mm", ylabel="along y, mm"
    )
    axes.set_aspect("equal")
    axes.set_title(f"{search.settings.method}: {len(search.pulses)} pulses")
    return colours


def _draw_skin(axes: Axes, mesh: Mesh, view: Transform) -> None:
    """Draw the shaded triangles that face the viewer, the farthest first (J. H. Lambert, Photometria, 1760)."""
    from matplotlib.collections import PolyCollection

    seen = (view @ mesh.vertices * 1e3)[mesh.faces]
    normals = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    front = normals[:, 2] > 0.0
    seen, normals = seen[front], normals[front] / np.linalg.norm(normals[front], axis=1, keepdims=True)
    order = np.argsort(seen[:, :, 2].mean(axis=1), kind="stable")
    shades = AMBIENT + (1.0 - AMBIENT) * np.clip(normals[order] @ LIGHT, 0.0, 1.0)
    colours = SKIN * shades[:, None]
    axes.add_collection(
        PolyCollection(list(seen[order][:, :, :2]), facecolors=colours, edgecolors=colours, linewidths=0.3)
    )


def _draw_expected(axes: Axes, search: HotspotSearch, view: Transform) -> Any:
    """Draw the expected amplitudes over the region at the best handle direction, on a mesh of spokes on the scalp."""
    from matplotlib.colors import LogNorm
    from matplotlib.tri import Triangulation

    angle = 0.0
    if search.responded:
        best = as_transform(search.estimate.image_from_coil)
        angle = heading(search.pose_at(best.translation), best)
    flat = _spokes((search.settings.rings + 0.5) * search.settings.spacing_mm / 1e3)
    on_plane = as_transform(search.places[0]) @ np.column_stack((flat, np.zeros(len(flat))))
    poses = [search.pose_at(point, angle) for point in on_plane]
    amplitudes_uv = np.maximum(search.expected_amplitudes(poses) * 1e6, LEAST_UV)
    seen = view @ np.array([pose.translation for pose in poses]) * 1e3
    scale = LogNorm(LEAST_UV, max(10.0 * LEAST_UV, float(amplitudes_uv.max())))
    triangles = Triangulation(seen[:, 0], seen[:, 1], Triangulation(*flat.T).triangles)
    return axes.tripcolor(triangles, amplitudes_uv, shading="gouraud", cmap=COLOURS, norm=scale, zorder=2)


def _spokes(reach: float) -> Floats:
    """Return points of a hexagon with corners at `reach`, on spokes from its middle, (1 + CIRCLES SPOKES, 2)."""
    angles = np.linspace(0.0, 2.0 * np.pi, SPOKES, endpoint=False)
    border = reach * np.cos(np.pi / 6.0) / np.cos(angles % (np.pi / 3.0) - np.pi / 6.0)
    rim = border[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    shares = np.arange(1, CIRCLES + 1) / CIRCLES
    return np.concatenate((np.zeros((1, 2)), (shares[:, None, None] * rim).reshape(-1, 2)))


def _draw_directions(axes: Axes, view: Transform, size_mm: float) -> None:
    """Draw the directions right, anterior and superior in a corner."""
    corner = np.array((-0.55, -0.45)) * size_mm
    axes.set(xlim=(-0.7 * size_mm, 0.7 * size_mm), ylim=(-0.6 * size_mm, 0.6 * size_mm))
    for name, axis in zip(("right", "anterior", "superior"), view.rotation[:2].T, strict=True):
        end = corner + 0.13 * size_mm * axis
        axes.annotate("", tuple(end), tuple(corner), arrowprops={"arrowstyle": "->", "color": "black"})
        axes.annotate(name, tuple(corner + 0.17 * size_mm * axis), ha="center", va="center", fontsize=8)


def _draw_pulses(axes: Axes, search: HotspotSearch, view: Transform) -> None:
    """Draw a dot at each pulse with a line along its +y, black for a response."""
    poses = [view @ as_transform(pulse.image_from_coil) for pulse in search.pulses]
    at = np.array([pose.translation[:2] for pose in poses]) * 1e3
    along = np.array([pose.rotation[:2, 1] for pose in poses]) * ARROW_MM / 3.0
    answered = np.array([pulse.amplitude >= search.settings.response_uv * 1e-6 for pulse in search.pulses])
    for colour, width in (("white", 2.2), ("black", 1.0)):  # seen on light and dark colours alike
        for start, end in zip(at, at + along, strict=True):
            axes.plot(*np.array((start, end)).T, color=colour, linewidth=width, zorder=3)
    for chosen, face, edge, label in (
        (~answered, "white", "black", "pulse without response"),
        (answered, "black", "white", "pulse with response"),
    ):
        axes.scatter(
            at[chosen, 0], at[chosen, 1], s=26, facecolor=face, edgecolor=edge, linewidth=0.9, zorder=4, label=label
        )


def _draw_coil(axes: Axes, pose: Transform, colour: str, marker: str, label: str) -> None:
    """Draw the position of a pose and the direction of its +y."""
    at, along = pose.translation[:2] * 1e3, pose.rotation[:2, 1] * ARROW_MM
    axes.annotate(
        "", tuple(at + along), tuple(at), arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 2.0}, zorder=5
    )
    size = 220.0 if marker == "o" else 90.0
    face = "none" if marker == "o" else colour
    axes.scatter(
        at[0], at[1], marker=marker, s=size, facecolor=face, edgecolor=colour, linewidth=2.0, zorder=6, label=label
    )


def _looking_from(direction: Floats, middle: Floats) -> Transform:
    """Return the view towards `middle` from a direction, z of the image upwards."""
    towards = direction / np.linalg.norm(direction)
    right = np.cross((0.0, 0.0, 1.0), towards)
    right /= np.linalg.norm(right)
    rotation = np.array((right, np.cross(towards, right), towards))
    return Transform(rotation, -rotation @ middle)
