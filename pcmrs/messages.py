"""The typed messages that cross the bus or the journal.

SI units; quaternions are ``quat_wxyz`` inside. Stamps are seconds of the sender's monotonic clock, so
that an age is (sent - captured) at the sender plus (now - received) at the receiver.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

Decision = Literal["accepted", "rejected", "failed", "unknown"]


class Message(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Base of all messages: immutable, by keyword, defaults left out on the wire."""


class Command(Message, frozen=True, kw_only=True):
    """A request that one operation of one branch be performed.

    Attributes:
        id: Unique per source; a repeat returns the recorded verdict and runs nothing.
        source: Who asks, such as ``udp:planner:127.0.0.1`` or ``bus:local``.
        sent: Unix seconds at which it was sent, if the sender said so.
        ttl: Seconds after `sent` beyond which it is refused as expired.
        parent: Id of the command whose step submitted this one.
    """

    id: str
    branch: str
    operation: str
    source: str
    arguments: dict[str, Any] = {}
    sent: float | None = None
    ttl: float | None = None
    parent: str | None = None


class Reason(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Why not: a stable code, a sentence, and the values in it."""

    code: str
    text: str
    fields: dict[str, Any] = {}


class Verdict(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What the dispatcher decided, and for operations how they ended.

    Attributes:
        state: State of the branch after the decision.
        allowed: Operations of the branch that would not be denied now.
        result: What the operation reports, such as ``residual`` in m.
        sequence: Number of the snapshot that shows the decision.
    """

    id: str
    branch: str
    operation: str
    decision: Decision
    state: str
    sequence: int
    reason: Reason | None = None
    allowed: list[str] = []
    result: dict[str, Any] | None = None


class Running(Message, frozen=True, kw_only=True, omit_defaults=False):
    """An operation in progress; `progress` grows from 0 to 1."""

    branch: str
    operation: str
    id: str
    progress: float = 0.0


class Ongoing(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The activity of the state that a branch is in; `values` are what it shows of itself."""

    branch: str
    state: str
    name: str
    values: dict[str, Any] = {}


class BlueprintTag(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Which workflow a decision was made under; `hash` is the SHA-256 of what the blueprint says."""

    id: str
    version: str
    hash: str


class Snapshot(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The joint state of all branches after one commit.

    Attributes:
        plan: Id of the accepted tool plan, if any.
        registration: Id of the accepted registration, if any.
        activities: What goes on besides operations, until the state it belongs to is left.
    """

    sequence: int
    branches: dict[str, str]
    flags: dict[str, bool]
    running: list[Running]
    latched: bool
    blueprint: BlueprintTag
    plan: str | None = None
    registration: str | None = None
    activities: list[Ongoing] = []


class Flags(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The flags of snapshot `sequence`, for displays; nothing is decided by them."""

    sequence: int
    flags: dict[str, bool]


class BodyPose(Message, frozen=True, kw_only=True):
    """One tracked body in one tracker frame, as the tracker measured it.

    Attributes:
        frame_number: Grows by one per tracker frame; a frozen number is a frozen tracker.
        captured: Sender's monotonic time of the exposure.
        sent: Sender's monotonic time of publication.
        valid: False when the tracker does not see the body; then `reason` says why.
        position: `tracker_from_body` translation, m.
        quat_wxyz: `tracker_from_body` rotation, unit quaternion.
        error: The tracker's own fit error, m.
    """

    body: str
    frame_number: int
    captured: float
    sent: float
    valid: bool
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    error: float = 0.0
    reason: str | None = None


class JointState(Message, frozen=True, kw_only=True):
    """Measured joints: positions in rad, velocities in rad/s, torques in N m, base to flange.

    Attributes:
        flange_force: External force on what the flange carries, N, along the flange's axes, without its weight;
            None where the arm has no estimate.
    """

    captured: float
    sent: float
    positions: list[float]
    velocities: list[float]
    torques: list[float]
    moving: bool = False
    flange_force: tuple[float, float, float] | None = None


class JointTrajectory(Message, frozen=True, kw_only=True):
    """Joint positions (rad) at a fixed `period` (s), starting with the present posture."""

    period: float
    positions: list[list[float]]


MotionOutcome = Literal["done", "stopped"]


class MotionResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """How a motion ended, and the joints (rad) measured then.

    Attributes:
        reason: Why it was stopped: ``held``, ``force_limit``, or a reason of the motion's own.
        force: With which the tool pressed then, N; only after `Robot.press`.
    """

    outcome: MotionOutcome
    positions: list[float]
    reason: str | None = None
    force: float | None = None


class ServoSession(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A stream of set points that a robot has agreed to follow.

    Attributes:
        session: Goes into every set point; grows with each session.
        deadman: The robot brakes by itself when no fresh set point has come for so long, s of the cell.
    """

    session: int
    deadman: float


class JointSetpoint(Message, frozen=True, kw_only=True):
    """Where the joints shall be now (rad) and how fast they shall go there (rad/s), base to flange.

    Attributes:
        session: Of a `ServoSession`; set points of another one are dropped.
        number: Grows within a session; a set point that is not newer than the last is dropped.
        sent: Sender's monotonic time.
    """

    session: int
    number: int
    sent: float
    positions: list[float]
    velocities: list[float]


class PressRequest(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Asks that the tool be pressed gently against the body.

    Attributes:
        force: To press with, N, 1 to 5.
        direction_in_flange: Unit vector along which to go and press, in the flange's axes.
        travel: Farthest way along it, m, 0.010 at most.
        speed: Greatest speed on it, m/s.
        timeout: Longest time, s of the cell, 20 at most.
    """

    force: float
    direction_in_flange: tuple[float, float, float]
    travel: float
    speed: float
    timeout: float


class LandmarkPrompt(Message, frozen=True, kw_only=True):
    """Asks the person with the pointer to touch one landmark.

    Attributes:
        index: From 0, in the order of the plan.
        position_in_image: Where the plan has it, m: what the person sees on the screen.
    """

    index: int
    name: str
    position_in_image: tuple[float, float, float]


class DeviceRequest(Message, frozen=True, kw_only=True):
    """A call to a device node: `method` of its protocol with `arguments`."""

    method: str
    arguments: dict[str, Any] = {}


class DeviceReply(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A device node's answer: a result, or the reason of the failure."""

    result: Any = None
    failure: Reason | None = None


class DeviceEvent(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Something a device reports by itself; `danger` events take the lane of Stop."""

    device: str
    code: str
    text: str
    danger: bool = False
    fields: dict[str, Any] = {}


class Beat(Message, frozen=True, kw_only=True):
    """A heartbeat; `number` grows by one each time."""

    number: int


class DeviceHealth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Whether a device node and its device are well."""

    device: str
    connected: bool
    text: str = ""


class PoseMessage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A pose as data: translation in m and unit ``quat_wxyz``."""

    position: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]


class SceneTruth(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Ground truth of a simulated scene: for reports and tests, never for control.

    The true pose of a planned tool is ``tracker_from_body_ref @ body_ref_from_image @ image_from_coil``.

    Attributes:
        time: Of the cell, at which all of it holds, s.
        contact_force: Between body and tool, N.
        tip_in_pointer: Where the pointer's tip truly is, in its marker body, m.
        tip_in_tracker: Where it is now, m; None while the pointer is away.
    """

    tracker_from_coil: PoseMessage
    tracker_from_body_ref: PoseMessage
    body_ref_from_image: PoseMessage
    time: float = 0.0
    contact_force: float = 0.0
    tip_in_pointer: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip_in_tracker: tuple[float, float, float] | None = None


class HeadStep(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A quick shift of the head by `offset` (m, along the tracker's axes), `time` s after the motion began."""

    time: float
    offset: tuple[float, float, float]


class HeadBurst(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The head goes at `speed` (m/s) for `duration` (s) along `direction` (unit vector), and stays there."""

    time: float
    duration: float
    speed: float
    direction: tuple[float, float, float]


class HeadMotion(Message, frozen=True, kw_only=True, omit_defaults=False):
    """How a simulated head moves, in cell time since it was set; by default it does not.

    Vectors are along the tracker's axes.

    Attributes:
        drift: Velocity, m/s.
        breathing_amplitude: Of a sine along `breathing_direction`, m.
        breathing_hz: Its frequency.
        breathing_direction: Unit vector.
        steps: Sudden shifts.
        bursts: Stretches of quick motion.
        seed: Gives the breathing its phase.
    """

    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    breathing_amplitude: float = 0.0
    breathing_hz: float = 0.25
    breathing_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    steps: list[HeadStep] = []
    bursts: list[HeadBurst] = []
    seed: int = 0


class Target(Message, frozen=True, kw_only=True, omit_defaults=False):
    """``image_from_coil`` of the accepted tool plan; both None when there is none."""

    plan: str | None = None
    pose: PoseMessage | None = None


class JournalQuery(Message, frozen=True, kw_only=True):
    """Asks for rows of the journal after sequence `after`, at most `limit`."""

    after: int = 0
    limit: int = 100


class JournalPage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Rows of the journal as plain data, oldest first."""

    rows: list[dict[str, Any]]
