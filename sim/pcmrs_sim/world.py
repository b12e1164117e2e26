"""The truth of the simulated cell, which all its devices share."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.messages import HeadMotion, PoseMessage, SceneTruth
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.errors import TouchErrors, TrackerErrors
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.motion import Pivot, head_offset
from pcmrs_sim.muscle.muscle import Muscle
from pcmrs_sim.muscle.subject import draw_subject
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ConfiguredPose, SimSettings
from pcmrs_sim.tms.subject import Subject

BODY_REF_FROM_WITNESS = Transform.from_rotvec((0.0, 0.08, 0.0), (0.3, 0.2, 0.0))
"""Where a second marker body was fixed to the patient, as long as nobody bumps the reference."""


class World:
    """Where everything truly is, and the errors that are drawn from the seed.

    Args:
        settings: Errors and geometry.
        facts: The arm.
        force: When the force on the tool is too great.
        time: At which it begins, s.

    Attributes:
        settings: Errors and geometry.
        phantom: What stands before the arm.
        arm: The simulated arm.
        time: Now, s of the cell.
        tracker_from_image: Where the patient's body is now.
        body_ref_from_image: The true registration.
        image_from_pointer: Where the pointer rests on the patient; None while it is on its way or away.
        pivot: How the pointer turns in a divot, if it does.
        hidden: Bodies that something hides from the tracker.
        tracker_errors: What the tracker adds to the truth.
        touch_errors: Where a person touches beside a planned landmark.
        muscle: Of the patient, which answers the stimulator.
        pulse_listeners: Told number, intensity in percent, and time, s, of every pulse.
    """

    def __init__(self, settings: SimSettings, facts: ArmFacts, force: ForceSettings, time: float) -> None:
        geometry = settings.geometry
        self.settings = settings
        self.phantom = phantom = PHANTOMS[settings.phantom]
        self.time = time
        self._world_from_tracker = geometry.world_from_tracker.transform
        self._tracker_from_world = self._world_from_tracker.inverse()
        self._flange_from_coil = geometry.flange_from_coil.transform
        self.body_ref_from_image = _placed(geometry.body_ref_from_image, phantom.body_ref_from_image)
        self._witness_from_image = BODY_REF_FROM_WITNESS.inverse() @ self.body_ref_from_image
        self.image_from_pointer: Transform | None = None
        self.pivot: Pivot | None = None
        self.hidden: set[str] = set()
        self.pulse_listeners: list[Callable[[int, float, float], None]] = []
        make = KinematicArm if settings.arm.physics == "kinematic" else Arm
        self.arm: Arm | KinematicArm = make(facts, settings, force, phantom)
        self._flange: Transform | None = None
        self._coil = self.tracker_from_coil()
        self._bodies: dict[str, tuple[Transform, Transform, Transform]] = {}
        self._motion, self._motion_start = HeadMotion(), time
        self._put(self._tracker_from_world @ _placed(geometry.world_from_image, phantom.world_from_image))
        self.reseed(settings.seed)

    def reseed(self, seed: int) -> None:
        """Draws the errors of tracker and landmarks, and the patient's muscle anew; the arm keeps its own."""
        self.tracker_errors = TrackerErrors(self.settings.tracker, np.random.default_rng(seed))
        self.touch_errors = TouchErrors(self.settings.digitization, seed)
        self.muscle = Muscle(self.settings.muscle, partial(draw_subject, self.settings.phantom, seed), seed)

    def step(self, steps: int) -> None:
        """Lets `steps` times `STEP` pass."""
        if self._motion == HeadMotion():
            self.arm.step(steps)
            self.time += steps * STEP
            return
        while steps > 0:
            stride = min(steps, self.arm.stride)
            self._move()
            self.arm.step(stride)
            self.time += stride * STEP
            steps -= stride

    def shift_body(self, offset_in_tracker: Floats) -> None:
        """Moves the patient at once, m, (3,)."""
        self._put(_shifted(offset_in_tracker, self._tracker_from_image_at_start))
        self._move()

    def set_motion(self, motion: HeadMotion) -> None:
        """The patient moves like that from where it is now."""
        self._put(self.tracker_from_image)
        self._motion, self._motion_start = motion, self.time

    def bump_reference(self, old_from_new: Transform) -> None:
        """Moves the reference on the patient; its marker body lies at `old_from_new` in where it was before."""
        self.body_ref_from_image = old_from_new.inverse() @ self.body_ref_from_image

    def stimulate(self, number: int, intensity: float, time: float) -> None:
        """Gives the pulse `number` at `time` of the cell's clock, s, from where the coil truly is.

        Args:
            number: Of the pulse.
            intensity: Percent of the maximum stimulator output.
            time: Of the cell's clock, s.
        """
        image_from_coil = self.tracker_from_image.inverse() @ self.tracker_from_coil()
        self.muscle.stimulate(number, time, image_from_coil, intensity)
        for listener in self.pulse_listeners:
            listener(number, intensity, time)

    def tracker_from_coil(self) -> Transform:
        """The true pose of the tool's marker body; the same object as long as the arm stands."""
        flange = self.arm.base_from_flange()
        if flange is not self._flange:
            self._flange, self._coil = flange, self._tracker_from_world @ flange @ self._flange_from_coil
        return self._coil

    def tracker_from_body_ref(self) -> Transform:
        """The true pose of the reference; the same object as long as nothing moves it."""
        return self._fixed("body_ref", self.body_ref_from_image)

    def tracker_from(self, body: str) -> Transform | None:
        """The true pose of a tracked body; None when it is not in the tracker's view at all."""
        if body == "coil":
            return self.tracker_from_coil()
        if body == "body_ref":
            return self.tracker_from_body_ref()
        if body == "witness":
            return self._fixed("witness", self._witness_from_image)
        return self._tracker_from_pointer()

    def truth(self) -> SceneTruth:
        """Everything as it is at this moment."""
        tip_in_pointer = self.settings.geometry.pointer_from_tip.position
        pointer = self._tracker_from_pointer()
        subject = self.muscle.subject
        known = subject if isinstance(subject, Subject) else None
        return SceneTruth(
            tracker_from_coil=_message(self.tracker_from_coil()),
            tracker_from_body_ref=_message(self.tracker_from_body_ref()),
            body_ref_from_image=_message(self.body_ref_from_image),
            time=self.time,
            contact_force=self.arm.contact.force,
            tip_in_pointer=tip_in_pointer,
            tip_in_tracker=None if pointer is None else _triple(pointer @ tip_in_pointer),
            image_from_hotspot=None if known is None else _message(known.image_from_hotspot),
            threshold=None if known is None else float(known.recruitment.threshold),
        )

    def _fixed(self, body: str, body_from_image: Transform) -> Transform:
        """The true pose of a body that is fixed to the patient."""
        known = self._bodies.get(body)
        if known is None or known[0] is not self.tracker_from_image or known[1] is not body_from_image:
            pose = self.tracker_from_image @ body_from_image.inverse()
            known = self._bodies[body] = (self.tracker_from_image, body_from_image, pose)
        return known[2]

    def _tracker_from_pointer(self) -> Transform | None:
        if self.pivot is not None and self.time > self.pivot.end:
            self.pivot = None
        image_from_pointer = self.image_from_pointer
        if self.pivot is not None:
            image_from_pointer = self.pivot.image_from_pointer(self.time)
        return None if image_from_pointer is None else self.tracker_from_image @ image_from_pointer

    def _put(self, tracker_from_image: Transform) -> None:
        self._tracker_from_image_at_start = self.tracker_from_image = tracker_from_image
        self.arm.contact.place(self._world_from_tracker @ tracker_from_image)

    def _move(self) -> None:
        offset = head_offset(self._motion, self.time - self._motion_start)
        self.tracker_from_image = _shifted(offset, self._tracker_from_image_at_start)
        self.arm.contact.place(self._world_from_tracker @ self.tracker_from_image)


def _placed(configured: ConfiguredPose | None, own: Transform) -> Transform:
    return own if configured is None else configured.transform


def _shifted(offset: Floats, pose: Transform) -> Transform:
    return Transform.from_quat_wxyz(offset, (1.0, 0.0, 0.0, 0.0)) @ pose


def _message(transform: Transform) -> PoseMessage:
    w, i, j, k = transform.quat_wxyz.tolist()
    return PoseMessage(position=_triple(transform.translation), quat_wxyz=(w, i, j, k))


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
