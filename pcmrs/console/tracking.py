"""What the tracker sees, in the scene: its measuring volume, its lines of sight, and which bodies it does not see."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console.cell_view_model import CellViewModel
from pcmrs.console.colours import BLUE, GREY, SKY
from pcmrs.console.geometry import Sight, along
from pcmrs.console.scene import STILL, put, show
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import Setup, SliceShown
from pcmrs.spatial import Floats, Transform

BODIES = ("coil", "body_ref", "witness", "pointer")
"""Those with a line of sight, where the tracker tells of them."""
OLD = 0.5
"""What was heard so long ago is not seen any more, s."""


class TrackingShown:
    """The tracker with what it measures; hidden until it is known where it stands.

    Args:
        scene: To draw in.
        setup: Of the cell.
    """

    def __init__(self, scene: ui.scene, setup: Setup) -> None:
        self._scene = scene
        with scene, scene.group() as self._tracker:
            scene.box(0.24, 0.06, 0.06).material(GREY).move(0.0, 0.0, 0.03)
            for start, end in edges(setup.volume):
                scene.line(start.tolist(), end.tolist()).material(BLUE)
        self._tracker.with_name("tracker").visible(False)
        with scene:
            self._sights = {body: self._sight(body) for body in BODIES}

    def follow(self, told: CellViewModel, sight: Sight, *, wanted: bool) -> None:
        """Show where the tracker stands, and a line to each body that it sees."""
        stand = sight.base_from_tracker if wanted else None
        show(self._tracker, stand)
        for body, line in self._sights.items():
            seen = sight.in_base(told.poses.get(body)) if is_seen(told, body) else None
            if stand is None or seen is None:
                show(line, None)
            else:
                _stretch(line, stand.translation, seen.translation)

    def _sight(self, body: str) -> Object3D:
        line = self._scene.cylinder(0.002, 0.002, 1.0, 8).material(SKY, 0.6)
        return line.with_name(f"sight of {body}").visible(False)


class VisibilityRow:
    """One word for each body: seen, or not and why.

    Args:
        texts: Of the page's language.
    """

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._row = ui.row().classes("gap-1").props('data-testid="visibility"')
        self._chips: dict[str, ui.badge] = {}

    def follow(self, told: CellViewModel) -> None:
        """Show what is seen now."""
        for body in told.poses:
            if body not in self._chips:
                with self._row:
                    self._chips[body] = ui.badge().classes("text-body2")
            seen, pose, chip = is_seen(told, body), told.poses[body], self._chips[body]
            why = "" if seen or pose.reason is None else f" ({pose.reason.replace('_', ' ')})"
            chip.set_text(f"{'●' if seen else '○'} {body}: {self._texts('seen' if seen else 'not_seen')}{why}")
            chip.props(f"color={'blue-9' if seen else 'deep-orange-10'}")


def is_seen(told: CellViewModel, body: str) -> bool:
    """Whether the tracker sees a body now: what it said of it last is no longer true when it has fallen silent."""
    pose, age = told.poses.get(body), told.age(body)
    return pose is not None and pose.valid and age is not None and age <= OLD


def edges(volume: list[SliceShown]) -> list[tuple[Floats, Floats]]:
    """The edges of a measuring volume in the tracker's frame, (3,) and (3,) each, m."""
    rings = [
        np.array([(x * each.width / 2.0, y * each.height / 2.0, -each.distance) for x, y in _CORNERS])
        for each in volume
    ]
    across = [(ring[n], ring[(n + 1) % 4]) for ring in rings for n in range(4)]
    lengthwise = [(near[n], far[n]) for near, far in pairwise(rings) for n in range(4)]
    return across + lengthwise


_CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def _stretch(line: Object3D, start: Floats, end: Floats) -> None:
    """Lay a cylinder of length 1 m between two points, (3,) each."""
    length = float(np.linalg.norm(end - start))
    if length > 0.0:
        if abs(length - line.sy) > STILL:
            line.scale(1.0, round(length, 4), 1.0)
        put(line, Transform(along((end - start) / length), (start + end) / 2.0))
        line.visible(True)
