"""Views for people in a recording, from messages of the bus: one topic for each kind of view."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from foxglove.messages import LogLevel

from pcmrs.bus.codec import convert_event, unpack
from pcmrs.errors import PcmrsError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.messages import BodyPose, DeviceHealth, Epoch, JointState, Message, PoseMessage, Snapshot, Target, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.setup import ProcedureDataView
from pcmrs.recording import _foxglove_messages
from pcmrs.recording._foxglove_messages import FoxgloveView
from pcmrs.recording.frame_tree import FrameLink, FrameTree, fixed_links
from pcmrs.recording.subscriber import RawSample
from pcmrs.spatial import Frame, Transform
from pcmrs.workflows.mounting import Mounting

T = TypeVar("T")
Shown = tuple[str, FoxgloveView]
"""Topic and message."""

LOG, STATE, HEALTH, JOINTS, TARGET = "/log", "/state", "/health", "/joints", "/target"
DATA, EPOCH, DAEMON = "/data", "/epoch", "/daemon"
TF_CALIBRATION, TF_ARM, TF_BASE = "/tf/calibration", "/tf/arm", "/tf/robot_base"
TF_BODIES, TF_IMAGE = "/tf/bodies", "/tf/image"

_SECOND = 1_000_000_000
BASE_PERIOD_NS = _SECOND
"""Period of the base of a robot that stands, ns: it is computed from each pose of the tool, and changes little."""
_LEVELS = {"accepted": LogLevel.Info, "rejected": LogLevel.Warning}


class RecordingViews:
    """Translator of messages into views; it stores those with which a later file must start.

    Args:
        arm: Facts of the arm.
        mounting: Calibrated poses.
        rate: Seconds of the cell, in which senders stamp, per second of the machine.
    """

    def __init__(self, arm: ArmFacts, mounting: Mounting, rate: float) -> None:
        self._names = [joint.name for joint in arm.joints]
        self._frames = FrameTree(arm, mounting)
        self._fixed = fixed_links(mounting)
        self._rate = rate
        self._latest: dict[str, tuple[str, Any]] = {}
        self._base_due_ns = 0
        self._translators: list[tuple[str, Callable[[RawSample, int], Iterator[Shown]]]] = [
            ("state/pose/", self._pose),
            ("state/joints", self._joints),
            ("state/fsm", self._last(STATE, Snapshot)),
            ("state/data", self._last(DATA, ProcedureDataView)),
            ("state/epoch", self._epoch),
            ("state/health", self._last(DAEMON, Health)),
            ("state/target", self._target),
            ("state/event", self._event),
            ("dev/", self._device),
        ]

    def of(self, sample: RawSample, at_ns: int) -> list[Shown]:
        """Return the views of a message.

        Args:
            sample: Message of the bus.
            at_ns: Time of arrival, ns since 1970.

        Returns:
            Topics and views; none for a key without views, a line of the log for a message that cannot be read.
        """
        translate = next((each for start, each in self._translators if sample.key.startswith(start)), None)
        if translate is None:
            return []
        try:
            return list(translate(sample, at_ns))
        except PcmrsError as error:
            return [(LOG, _foxglove_messages.line(LogLevel.Warning, "recorder", f"{sample.key}: {error.text}", at_ns))]

    def opening(self, at_ns: int) -> list[Shown]:
        """Return the views with which a file starts, so that it can be read without the files before it.

        Args:
            at_ns: Time of the start, ns since 1970.
        """
        fixed = [(TF_CALIBRATION, self._linked(link, at_ns)) for link in self._fixed]
        return [*fixed, *((topic, view(at_ns)) for topic, view in self._latest.values())]

    def _pose(self, sample: RawSample, at_ns: int) -> Iterator[Shown]:
        pose = unpack(sample.payload, BodyPose)
        if not pose.valid:
            return
        captured_ns = at_ns - self._age_ns(pose.sent - pose.captured)
        tracker_from_body = _transform(pose)
        yield TF_BODIES, _foxglove_messages.link(Frame.TRACKER, pose.body, tracker_from_body, captured_ns)
        if pose.body != Frame.TOOL_MARKER or at_ns < self._base_due_ns:
            return
        base = self._frames.tool(tracker_from_body)
        if base is not None:
            self._base_due_ns = at_ns + BASE_PERIOD_NS
            yield self._stored("base", TF_BASE, lambda at: self._linked(base, at), captured_ns)

    def _joints(self, sample: RawSample, at_ns: int) -> Iterator[Shown]:
        state = unpack(sample.payload, JointState)
        captured_ns = at_ns - self._age_ns(state.sent - state.captured)
        flange = self._frames.joints(state)
        if state.moving:
            self._base_due_ns = 0  # the next standstill is shown at once
        if len(state.velocities) == len(self._names):
            yield JOINTS, _foxglove_messages.joints(self._names, state.positions, state.velocities, captured_ns)
        yield TF_ARM, self._linked(flange, captured_ns)

    def _last(self, topic: str, kind: type[Message]) -> Callable[[RawSample, int], Iterator[Shown]]:
        """Return a translator for messages that are valid until the next one."""

        def translate(sample: RawSample, at_ns: int) -> Iterator[Shown]:
            message = unpack(sample.payload, kind)
            yield self._stored(sample.key, topic, lambda _: message, at_ns)

        return translate

    def _device(self, sample: RawSample, at_ns: int) -> Iterator[Shown]:
        if sample.key.endswith("/state"):
            yield from self._last(HEALTH, DeviceHealth)(sample, at_ns)

    def _epoch(self, sample: RawSample, _: int) -> Iterator[Shown]:
        yield EPOCH, unpack(sample.payload, Epoch)

    def _target(self, sample: RawSample, at_ns: int) -> Iterator[Shown]:
        target = unpack(sample.payload, Target)
        self._latest.pop("image", None)
        self._latest.pop("target", None)
        if target.body_ref_from_image is not None:
            body_ref_from_image = _transform(target.body_ref_from_image)
            link = Frame.REFERENCE, Frame.IMAGE, body_ref_from_image
            yield self._stored("image", TF_IMAGE, lambda at: _foxglove_messages.link(*link, at), at_ns)
        if target.pose is not None:
            image_from_coil = _transform(target.pose)
            yield self._stored(
                "target", TARGET, lambda at: _foxglove_messages.pose_in(Frame.IMAGE, image_from_coil, at), at_ns
            )

    def _event(self, sample: RawSample, at_ns: int) -> Iterator[Shown]:
        event = convert_event(unpack(sample.payload, dict))
        if isinstance(event, Verdict):
            level = _LEVELS.get(event.decision, LogLevel.Error)
            yield LOG, _foxglove_messages.line(level, f"{event.branch}.{event.operation}", _text(event), at_ns)
        else:
            level = LogLevel.Error if event.danger else LogLevel.Warning
            yield LOG, _foxglove_messages.line(level, event.device, f"{event.code}: {event.text}", at_ns)

    def _stored(self, key: str, topic: str, view: Callable[[int], FoxgloveView], at_ns: int) -> Shown:
        self._latest[key] = topic, view
        return topic, view(at_ns)

    def _linked(self, link: FrameLink, at_ns: int) -> FoxgloveView:
        return _foxglove_messages.link(*link, at_ns)

    def _age_ns(self, age: float) -> int:
        """Return the age of a measurement, ns; 0 for an implausible one."""
        seconds = age / self._rate
        return int(seconds * _SECOND) if 0.0 <= seconds < 60.0 else 0


def _transform(pose: PoseMessage | BodyPose) -> Transform:
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def _text(verdict: Verdict) -> str:
    reason = "" if verdict.reason is None else f": {verdict.reason.code}: {verdict.reason.text}"
    return f"{verdict.decision}, {verdict.branch} is in {verdict.state}{reason}"
