"""The true state of the simulated cell, which all its devices share."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.messages import HeadMotion, PoseMessage, SceneTruth
from pcmrs.spatial import Floats, Transform, trusted_transform
from pcmrs_sim.arm import Arm
from pcmrs_sim.cell_state import CellState
from pcmrs_sim.error_models import RestingPlaces, TouchErrors, TrackerErrors
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.motion import Pivot, Slide, head_offset
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.muscle.muscle import Muscle
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ConfiguredPose, SimSettings
from pcmrs_sim.tms.subject import Subject

AWAY = Transform(np.eye(3), np.array([0.0, 0.0, -3.0]))
"""Pose of the pointer in the world while nobody holds it at the patient: below the floor, where no camera sees it."""
BODY_REF_FROM_WITNESS = Transform.from_rotvec((0.0, -0.12, 0.0), (0.3, 0.2, 0.0))
"""Pose of a second marker body on the patient, in the reference as it is before anyone bumps it."""


class World:
    """True poses of all bodies, and the errors that are drawn from the seed.

    Args:
        settings: Errors and geometry.
        facts: Nominal geometry and limits of the arm.
        force: Limit of the force on the tool, and the relief from it.
        time: Time at the start, s of the cell.

    Attributes:
        settings: Errors and geometry.
        phantom: The body in front of the arm.
        arm: The simulated arm.
        time: Present time, s of the cell.
        tracker_from_image: Present pose of the patient.
        body_ref_from_image: The true registration.
        image_from_pointer: Pose of the pointer at rest on the patient; None while it moves or is away.
        pointer_motion: Motion of the pointer in a hand that pivots or slides it; None while it rests or is away.
        hidden: Bodies that are hidden from the tracker.
        tracker_errors: Errors of the tracker.
        touch_errors: Errors of touches.
        muscle: The patient's muscle, which responds to the stimulator.
        pulse_listeners: Functions that are called with number, intensity in percent and time, s, of each pulse.
    """

    def __init__(self, settings: SimSettings, facts: ArmFacts, force: ForceSettings, time: float) -> None:
        geometry = settings.geometry
        self.settings = settings
        self.phantom = phantom = PHANTOMS[settings.phantom]
        self.time = time
        self._world_from_tracker = geometry.world_from_tracker.transform
        self.body_ref_from_image = _pose(geometry.body_ref_from_image, phantom.body_ref_from_image)
        self.image_from_pointer: Transform | None = None
        self.pointer_motion: Pivot | Slide | None = None
        self.hidden: set[str] = set()
        self.pulse_listeners: list[Callable[[int, float, float], None]] = []
        make = KinematicArm if settings.arm.physics == "kinematic" else Arm
        self.arm: Arm | KinematicArm = make(facts, settings, force, phantom)
        self._resting = RestingPlaces(settings.arm.repeatability_mm * 1e-3, settings.seed)
        self._motion_of_arm: object = None
        image_from_body_ref = self.body_ref_from_image.inverse()
        self.arm.cell.fix("body_ref", image_from_body_ref)
        self.arm.cell.fix("witness", image_from_body_ref @ BODY_REF_FROM_WITNESS)
        self._placed_pointer: tuple[Transform | None, Transform] | None = None
        self._motion, self._motion_start = HeadMotion(), time
        world_from_image = _pose(geometry.world_from_image, phantom.world_from_image)
        self._set_start_pose(self._world_from_tracker.inverse() @ world_from_image)
        self.reseed(settings.seed)

    def reseed(self, seed: int) -> None:
        """Draw new errors of tracker and touches, and a new muscle. The errors of the arm stay."""
        self.tracker_errors = TrackerErrors(self.settings.tracker, np.random.default_rng(seed))
        self.touch_errors = TouchErrors(self.settings.digitization, seed)
        self.muscle = Muscle(self.settings.muscle, partial(draw_subject, self.settings.phantom, seed), seed)

    def step(self, steps: int) -> None:
        """Advance by a number of steps of `STEP`."""
        if self._motion == HeadMotion():  # the patient is at rest, so that all steps are one stride
            self.arm.step(steps)
            self.time += steps * STEP
            return
        while steps > 0:
            stride = min(steps, self.arm.stride)
            self._apply_motion()
            self.arm.step(stride)
            self.time += stride * STEP
            steps -= stride

    def shift_body(self, offset_in_tracker: Floats) -> None:
        """Shift the patient at once by an offset in the tracker frame, m, (3,)."""
        self._set_start_pose(_shifted(offset_in_tracker, self._tracker_from_image_at_start))
        self._apply_motion()

    def set_motion(self, motion: HeadMotion) -> None:
        """Start a motion of the patient from its present pose."""
        self._set_start_pose(self.tracker_from_image)
        self._motion, self._motion_start = motion, self.time

    def bump_reference(self, old_from_new: Transform) -> None:
        """Move the reference on the patient.

        Args:
            old_from_new: New pose of its marker body in the frame of the old one.
        """
        self.body_ref_from_image = old_from_new.inverse() @ self.body_ref_from_image
        self.arm.cell.fix("body_ref", self.body_ref_from_image.inverse())

    def stimulate(self, number: int, intensity: float, time: float) -> None:
        """Give a pulse from the true pose of the coil.

        Args:
            number: Number of the pulse.
            intensity: Percent of the maximum stimulator output.
            time: Time of the pulse on the cell's clock, s.
        """
        image_from_coil = self.tracker_from_image.inverse() @ self.tracker_from_tool_tip()
        self.muscle.stimulate(number, time, image_from_coil, intensity)
        for listener in self.pulse_listeners:
            listener(number, intensity, time)

    def tracker_from_tool_tip(self) -> Transform:
        """Return the true pose of the tool's contact point; the same object as long as the arm stands still."""
        return self.observe().pose("tracker_from_tool_tip")

    def observe(self) -> CellState:
        """Return the model of the cell with all bodies where they are now."""
        cell = self.arm.observe()
        if self.arm.reference is not self._motion_of_arm:
            self._motion_of_arm = self.arm.reference
            cell.displace_arm(self._resting.draw())
        held = self._image_from_pointer()
        placed = self._placed_pointer
        if placed is None or placed[0] is not held or placed[1] is not self.tracker_from_image:
            self._placed_pointer = held, self.tracker_from_image
            cell.place("pointer", AWAY if held is None else self._world_from_tracker @ self.tracker_from_image @ held)
        return cell

    def spheres_seen_with(self, image_from_pointer: Transform) -> int:
        """Return how many spheres of all marker bodies the tracker would see with the pointer at a pose."""
        cell = self.observe()
        cell.place("pointer", self._world_from_tracker @ self.tracker_from_image @ image_from_pointer)
        self._placed_pointer = None  # so that it returns
        return sum(int(cell.sight(body).seen.sum()) for body in MARKER_BODIES)

    def is_near_body(self, within: float) -> bool:
        """Return whether the body is in front of the face of the tool, within a distance, m."""
        image_from_tool = self.tracker_from_image.inverse() @ self.tracker_from_tool_tip()
        axis = image_from_tool.rotation[:, 2]
        origin = image_from_tool.translation - within * axis
        return self.phantom.solid.touch(origin, axis, self.phantom.tool_radius) is not None

    def tracker_from_body_ref(self) -> Transform:
        """Return the true pose of the reference; the same object as long as nothing moves it."""
        return self.observe().pose("tracker_from_body_ref")

    def tracker_from(self, body: str) -> Transform | None:
        """Return the true pose of a tracked body, the same object as long as nothing moves it.

        It is None for a pointer that nobody holds at the patient.
        """
        if body == "pointer" and self._image_from_pointer() is None:
            return None
        return self.observe().pose(f"tracker_from_{body}")

    def truth(self) -> SceneTruth:
        """Return the present true state."""
        tip_in_pointer = self.settings.geometry.pointer_from_tip.position
        held = self._image_from_pointer() is not None
        tip = self.observe().pose("tracker_from_pointer_tip").translation
        subject = self.muscle.subject
        known = subject if isinstance(subject, Subject) else None
        return SceneTruth(
            tracker_from_coil=_message(self.tracker_from_tool_tip()),
            tracker_from_body_ref=_message(self.tracker_from_body_ref()),
            body_ref_from_image=_message(self.body_ref_from_image),
            time=self.time,
            contact_force=self.arm.contact.force,
            tip_in_pointer=tip_in_pointer,
            tip_in_tracker=_triple(tip) if held else None,
            image_from_hotspot=None if known is None else _message(known.image_from_hotspot),
            threshold=None if known is None else float(known.recruitment.threshold),
        )

    def _image_from_pointer(self) -> Transform | None:
        """Return the present pose of the pointer at the patient; None if it is away."""
        if self.pointer_motion is not None and self.time > self.pointer_motion.end:
            self.pointer_motion = None
        moving = self.pointer_motion
        return self.image_from_pointer if moving is None else moving.image_from_pointer(self.time)

    def _set_start_pose(self, tracker_from_image: Transform) -> None:
        """Place the patient at a pose, from which its motion is measured."""
        self._tracker_from_image_at_start = tracker_from_image
        self._place_patient(tracker_from_image)

    def _apply_motion(self) -> None:
        """Place the patient at its pose at the present time."""
        offset = head_offset(self._motion, self.time - self._motion_start)
        self._place_patient(_shifted(offset, self._tracker_from_image_at_start))

    def _place_patient(self, tracker_from_image: Transform) -> None:
        self.tracker_from_image = tracker_from_image
        world_from_image = self._world_from_tracker @ tracker_from_image
        self.arm.contact.place(world_from_image)
        self.arm.cell.place("body", world_from_image)


def _pose(configured: ConfiguredPose | None, default: Transform) -> Transform:
    return default if configured is None else configured.transform


def _shifted(offset: Floats, pose: Transform) -> Transform:
    return trusted_transform(pose.rotation, offset + pose.translation)


def _message(transform: Transform) -> PoseMessage:
    w, i, j, k = transform.quat_wxyz.tolist()
    return PoseMessage(position=_triple(transform.translation), quat_wxyz=(w, i, j, k))


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
