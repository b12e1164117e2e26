"""The tracker in the scene: its measuring volume, its lines of sight, and the bodies that it does not see."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._colours import BLUE, GREY, SKY
from pcmrs.console._geometry import TrackerLocator, along
from pcmrs.console._scene import STILL, put, show
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup, SliceShown
from pcmrs.spatial import Floats, Transform

BODIES = ("coil", "body_ref", "witness", "pointer")
"""Bodies with a line of sight, if the tracker reports them."""
MAX_AGE = 0.5
"""Age of a pose from which a body is not seen any more, s."""


class TrackingView:
    """The tracker with its lines of sight; hidden until its pose is known.

    Args:
        scene: Scene to draw in.
        setup: Setup of the cell.
    """

    def __init__(self, scene: ui.scene, setup: Setup) -> None:
        self._scene = scene
        with scene, scene.group() as self._tracker:
            scene.box(0.24, 0.06, 0.06).material(GREY).move(0.0, 0.0, 0.03)
            for start, end in edges(setup.volume):
                scene.line(start.tolist(), end.tolist()).material(BLUE)
        self._tracker.with_name("tracker").visible(False)
        with scene:
            self._sights = {body: self._line_of_sight(body) for body in BODIES}

    def follow(self, view: CellViewModel, locator: TrackerLocator, *, wanted: bool) -> None:
        """Show the pose of the tracker, and a line to each body that it sees.

        Args:
            view: State of the cell to show.
            locator: Locates the tracker.
            wanted: Show it at all.
        """
        stand = locator.base_from_tracker if wanted else None
        show(self._tracker, stand)
        for body, line in self._sights.items():
            seen = locator.in_base(view.poses.get(body)) if _is_seen(view, body) else None
            if stand is None or seen is None:
                show(line, None)
            else:
                _stretch(line, stand.translation, seen.translation)

    def _line_of_sight(self, body: str) -> Object3D:
        line = self._scene.cylinder(0.002, 0.002, 1.0, 8).material(SKY, 0.6)
        return line.with_name(f"sight of {body}").visible(False)


class VisibilityRow:
    """One word for each body: seen, or not and why.

    Args:
        texts: Texts in the language of the page.
    """

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._row = ui.row().classes("gap-1").props('data-testid="visibility"')
        self._chips: dict[str, ui.badge] = {}

    def follow(self, view: CellViewModel) -> None:
        """Show the present visibility."""
        for body in view.poses:
            if body not in self._chips:
                with self._row:
                    self._chips[body] = ui.badge().classes("text-body2")
            seen, pose, chip = _is_seen(view, body), view.poses[body], self._chips[body]
            why = "" if seen or pose.reason is None else f" ({pose.reason.replace('_', ' ')})"
            chip.set_text(f"{'●' if seen else '○'} {body}: {self._texts('seen' if seen else 'not_seen')}{why}")
            chip.props(f"color={'blue-9' if seen else 'deep-orange-10'}")


def _is_seen(view: CellViewModel, body: str) -> bool:
    """Return true if the tracker sees a body now. Its last report is no longer true when it has stopped reporting.

    Args:
        view: State of the cell.
        body: Name of the body.
    """
    pose, age = view.poses.get(body), view.age(body)
    return pose is not None and pose.valid and age is not None and age <= MAX_AGE


def edges(volume: list[SliceShown]) -> list[tuple[Floats, Floats]]:
    """Return the edges of a measuring volume in the tracker's frame, (3,) and (3,) each, m."""
    rings = [
        np.array([(x * each.width / 2.0, y * each.height / 2.0, -each.distance) for x, y in _CORNERS])
        for each in volume
    ]
    across = [(ring[n], ring[(n + 1) % 4]) for ring in rings for n in range(4)]
    lengthwise = [(near[n], far[n]) for near, far in pairwise(rings) for n in range(4)]
    return across + lengthwise


_CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def _stretch(line: Object3D, start: Floats, end: Floats) -> None:
    """Stretch a cylinder of length 1 m between two points, (3,) each."""
    length = float(np.linalg.norm(end - start))
    if length > 0.0:
        if abs(length - line.sy) > STILL:
            line.scale(1.0, round(length, 4), 1.0)
        put(line, Transform(along((end - start) / length), (start + end) / 2.0))
        line.visible(True)
