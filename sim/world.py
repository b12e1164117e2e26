"""The truth of the simulated cell, which all its devices share."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.spatial import Transform
from sim.arm import Arm
from sim.errors import TouchErrors, TrackerErrors
from sim.phantoms import PHANTOMS
from sim.settings import Pose, SimSettings


class World:
    """Where everything truly is, and the errors that are drawn from the seed.

    Args:
        settings: Errors and geometry.
        arm_name: A key of `ARMS`.

    Attributes:
        settings: Errors and geometry.
        phantom: What stands before the arm.
        arm: The simulated arm.
        tracker_from_body_ref: Where the patient is now.
        body_ref_from_image: The true registration.
        body_ref_from_pointer: Where the pointer rests on the patient; None while it is on its way or away.
        hidden: Bodies that something hides from the tracker.
        tracker_errors: What the tracker adds to the truth.
        touch_errors: Where a person touches beside a planned landmark.
    """

    def __init__(self, settings: SimSettings, arm_name: str) -> None:
        geometry = settings.geometry
        self.settings = settings
        self.phantom = phantom = PHANTOMS[settings.phantom]
        self._model = ArmModel(ARMS[arm_name])
        self._tracker_from_world = geometry.world_from_tracker.transform.inverse()
        self._flange_from_coil = geometry.flange_from_coil.transform
        self.body_ref_from_image = _placed(geometry.body_ref_from_image, phantom.body_ref_from_image)
        world_from_image = _placed(geometry.world_from_image, phantom.world_from_image)
        world_from_body_ref = world_from_image @ self.body_ref_from_image.inverse()
        self.tracker_from_body_ref = self._tracker_from_world @ world_from_body_ref
        self.body_ref_from_pointer: Transform | None = None
        self.hidden: set[str] = set()
        rng = np.random.default_rng(settings.seed)
        self.arm = Arm(ARMS[arm_name], settings.arm, self._flange_from_coil, phantom, rng)
        self.reseed(settings.seed)

    def reseed(self, seed: int) -> None:
        """Draws the errors of tracker and landmarks anew; the arm keeps its own."""
        self.tracker_errors = TrackerErrors(self.settings.tracker, np.random.default_rng(seed))
        self.touch_errors = TouchErrors(self.settings.digitization, seed)

    def tracker_from_coil(self) -> Transform:
        """The true pose of the tool's marker body."""
        return self._tracker_from_world @ self._model.forward(self.arm.positions) @ self._flange_from_coil

    def tracker_from(self, body: str) -> Transform | None:
        """The true pose of a tracked body; None when it is not in the tracker's view at all."""
        if body == "coil":
            return self.tracker_from_coil()
        if body == "body_ref":
            return self.tracker_from_body_ref
        if self.body_ref_from_pointer is None:
            return None
        return self.tracker_from_body_ref @ self.body_ref_from_pointer

    def truth(self) -> SceneTruth:
        """The true poses at this moment."""
        return SceneTruth(
            tracker_from_coil=_message(self.tracker_from_coil()),
            tracker_from_body_ref=_message(self.tracker_from_body_ref),
            body_ref_from_image=_message(self.body_ref_from_image),
        )


def _placed(configured: Pose | None, own: Transform) -> Transform:
    return own if configured is None else configured.transform


def _message(transform: Transform) -> PoseMessage:
    x, y, z = transform.translation.tolist()
    w, i, j, k = transform.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))
