"""The body in the scene: surface or predicted error, its zone, landmarks planned and digitized."""

from __future__ import annotations

from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._geometry import residuals
from pcmrs.console._scene import BOX, GOOD, OPEN, POOR, SKIN, show
from pcmrs.console._surfaces import LIGHTER, ZONE, Surfaces
from pcmrs.messages import PoseMessage
from pcmrs.messages.setup import LandmarkShown, Setup
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_transform

BALL, CUBE = 0.004, 0.006
"""Radius of a planned landmark, edge of a digitized one, m."""


class BodyView:
    """Everything that moves with the body's reference.

    Args:
        scene: Scene to draw in.
        view: State of the cell to show.
        setup: Setup of the cell.
        surfaces: Served surfaces of the body.
    """

    def __init__(self, scene: ui.scene, view: CellViewModel, setup: Setup, surfaces: Surfaces) -> None:
        self._scene, self._view, self._setup, self._surfaces = scene, view, setup, surfaces
        self._drawn: tuple[list[LandmarkShown], PoseMessage | None] = ([], None)
        self._landmarks: list[Object3D] = []
        self._plain: Object3D | None = None
        self._zone: Object3D | None = None
        self._coloured: tuple[str, Object3D] | None = None
        with scene, scene.group() as self._image:
            if setup.surface is not None:
                self._plain = scene.stl(LIGHTER).material(SKIN, 0.9).with_name("surface")
                self._zone = scene.stl(ZONE).material(BOX, 0.3, "back").with_name("zone of the body")
        self._image.with_name("body").visible(False)
        with scene, scene.group() as self._reference:
            pass
        self._reference.with_name("body_ref").visible(False)

    def follow(self, base_from_body_ref: Transform | None, *, zone: bool) -> Transform | None:
        """Move it to the pose that the tracker sees.

        Args:
            base_from_body_ref: Pose of the reference; None while unknown.
            zone: Show the zone of the body.

        Returns:
            ``base_from_image``; None while unknown.
        """
        registered = self._view.data.body_ref_from_image
        image = None
        if registered is not None and base_from_body_ref is not None:
            image = base_from_body_ref @ as_transform(registered)
        show(self._image, image)
        show(self._reference, base_from_body_ref)
        if self._zone is not None:
            self._zone.visible(zone)
        data = self._view.data
        if (data.landmarks, data.body_ref_from_image) != self._drawn:
            self._drawn = data.landmarks, data.body_ref_from_image
            self._draw_landmarks()
        return image

    async def colour(self, *, wanted: bool) -> None:
        """Colour the surface by the predicted error, or show it plain."""
        where = await self._surfaces.error(self._setup, self._view.data) if wanted else None
        if where == (None if self._coloured is None else self._coloured[0]):
            return
        if self._coloured is not None:
            self._coloured[1].delete()
            self._coloured = None
        if where is not None:
            with self._scene, self._image:
                self._coloured = (where, self._scene.gltf(where).with_name("predicted error"))
        if self._plain is not None:
            self._plain.visible(where is None)

    def _draw_landmarks(self) -> None:
        """Draw planned landmarks as balls, digitized ones as cubes, both coloured by their distance."""
        for each in self._landmarks:
            each.delete()
        self._landmarks = []
        for landmark, residual in zip(self._view.data.landmarks, residuals(self._view.data), strict=True):
            colour = OPEN if residual is None else GOOD if residual <= self._setup.residual_limit else POOR
            with self._scene, self._image:
                ball = self._scene.sphere(BALL, 8, 5).material(colour).with_name(f"landmark {landmark.name}")
                self._landmarks.append(ball.move(*landmark.planned))
            if landmark.digitized is not None:
                with self._scene, self._reference:
                    cube = self._scene.box(CUBE, CUBE, CUBE).material(colour).with_name(f"digitized {landmark.name}")
                    self._landmarks.append(cube.move(*landmark.digitized))
