"""The keys of a cell: how they are built and taken apart, and what is found on each.

A key is `pcmrs/<site>/<cell>/` and a relative key such as ``state/fsm``. Everything but the session
itself works with relative keys.
"""

from __future__ import annotations

import re
from typing import Final, Literal

from pcmrs.errors import PayloadError
from pcmrs.messages import Message
from pcmrs.messages.identity import COMMANDING, HOLDING, Role

_CHUNK = re.compile(r"[a-z0-9][a-z0-9._-]*")

Use = Literal["query", "put", "put or query", "subscribe"]


class KeyInfo(Message, frozen=True, kw_only=True, omit_defaults=False):
    """One row of the key table, as seen by somebody outside the daemon.

    Attributes:
        key: Relative key; ``<name>`` stands for one chunk, ``<user>`` for the name of who uses it.
        use: What a client does with it.
        payload: What is sent and, after an arrow, what comes back.
        text: What it is for.
        users: Roles that may do so.
        owners: Roles that serve or publish it.
    """

    key: str
    use: Use
    payload: str
    text: str
    users: tuple[Role, ...]
    owners: tuple[Role, ...]


class KeyTable(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to ``svc/keys``."""

    prefix: str
    keys: list[KeyInfo]


EVERYBODY: Final[tuple[Role, ...]] = ("operator", "planner", "viewer", "device", "teleoperator", "daemon")
READERS: Final[tuple[Role, ...]] = ("operator", "planner", "viewer", "teleoperator", "daemon")
DAEMON: Final[tuple[Role, ...]] = ("daemon",)
DEVICE: Final[tuple[Role, ...]] = ("device",)
TOLD_ON_SITE: Final[tuple[Role, ...]] = ("device", "daemon")
"""Sent by devices; those on the daemon's machine are behind it, so that to a router it is the daemon who sends."""


def _row(
    key: str, use: Use, payload: str, text: str, users: tuple[Role, ...], owners: tuple[Role, ...] = DAEMON
) -> KeyInfo:
    return KeyInfo(key=key, use=use, payload=payload, text=text, users=users, owners=owners)


KEYS = [
    _row(
        "cmd/<user>/<branch>/<operation>",
        "put or query",
        '{"id"?, "sent"?, "ttl"?, "arguments"?} -> Verdict',
        "Asks for an operation. A query is answered with the verdict; that of a put appears on state/event.",
        COMMANDING,
    ),
    # The robot's node hears it by itself, whatever has become of the daemon.
    _row(
        "stop/<user>",
        "put or query",
        "Press, or anything -> Stopping",
        "Stops every motion and latches.",
        EVERYBODY,
        ("daemon", "device"),
    ),
    _row("state/fsm", "subscribe", "Snapshot", "State of all branches after each commit; the last is kept.", READERS),
    _row("state/event", "subscribe", "Verdict | DeviceEvent", "Decisions and device events as they happen.", READERS),
    _row("state/joints", "subscribe", "JointState", "Measured joints of the arm.", READERS, TOLD_ON_SITE),
    _row(
        "state/pose/<body>",
        "subscribe",
        "BodyPose",
        "Pose of a tracked body in the tracker frame.",
        READERS,
        TOLD_ON_SITE,
    ),
    _row("state/flags", "subscribe", "Flags", "The flags that mirror the states, for displays.", READERS),
    _row("state/target", "subscribe", "Target", "Planned tool pose in the image, and the registration.", READERS),
    _row("state/data", "subscribe", "ProcedureDataView", "What svc/data answers, whenever that has changed.", READERS),
    _row("state/epoch", "subscribe", "Epoch", "What a muscle answered to each pulse, as it was measured.", READERS),
    _row("state/health", "subscribe", "Health", "What svc/health answers, every few seconds, for recordings.", READERS),
    _row("teleop/<user>", "put", "TeleopSetpoint", "Set points of who has engaged the clutch.", HOLDING),
    _row("state/teleop", "subscribe", "TeleopStatus", "How guiding goes, while the tool is guided.", READERS),
    _row("svc/snapshot", "query", "nothing -> Snapshot", "The present state, for those who join late.", READERS),
    _row("svc/health", "query", "nothing -> Health", "How the daemon is, and why it is not well.", READERS),
    _row(
        "svc/journal",
        "query",
        '{"after"?, "before"?, "limit"?} -> JournalPage',
        "What was decided, a page at a time.",
        ("operator", "viewer", "daemon"),
    ),
    _row("svc/setup/<user>", "query", "nothing -> Setup", "What a console shows: workflow, arm, tool, body.", READERS),
    _row(
        "svc/data",
        "query",
        "nothing -> ProcedureDataView",
        "Landmarks, digitization, registration and plan so far.",
        READERS,
    ),
    _row(
        "svc/check/<user>",
        "query",
        '{"branch", "operation", "arguments"?} -> DryRunResult',
        "What would be said to a command now; nothing is done.",
        COMMANDING,
    ),
    _row("svc/keys", "query", "nothing -> KeyTable", "This table.", READERS),
    _row("dev/<device>/cmd", "query", "DeviceRequest -> DeviceReply", "Calls a method of a device.", DAEMON, DEVICE),
    _row("dev/<device>/state", "subscribe", "DeviceHealth", "Whether a device is well.", READERS, TOLD_ON_SITE),
    _row("dev/<device>/beat", "subscribe", "NodeBeat", "Heartbeats of a device's node.", DAEMON, DEVICE),
    _row("daemon/beat", "subscribe", "Beat", "Signs of life of the daemon's loop.", DEVICE),
    _row("daemon/event", "subscribe", "DeviceEvent", "What the daemon's own processes report.", DAEMON),
    _row("dev/robot/setpoint", "subscribe", "JointSetpoint", "Set points of a servo session.", DEVICE),
    _row("dev/<device>/event", "subscribe", "DeviceEvent", "What a device reports by itself.", DAEMON, DEVICE),
    _row("ros2/joint_states", "subscribe", "CDR: sensor_msgs/msg/JointState", "state/joints for ROS 2.", READERS),
    _row("ros2/tf", "subscribe", "CDR: tf2_msgs/msg/TFMessage", "Frames that move, for ROS 2.", READERS),
    _row("ros2/tf_static", "subscribe", "CDR: tf2_msgs/msg/TFMessage", "Frames that are fixed, for ROS 2.", READERS),
    _row("ros2/pose/<body>", "subscribe", "CDR: geometry_msgs/msg/PoseStamped", "state/pose/* for ROS 2.", READERS),
    _row("ros2/state", "subscribe", "CDR: std_msgs/msg/String", "state/fsm as JSON for ROS 2.", READERS),
    _row(
        "ros2/tracker/<body>",
        "subscribe",
        "CDR: geometry_msgs/msg/PoseStamped",
        "Poses that sensors of ROS 2 measure, for the driver ros2.",
        TOLD_ON_SITE,
        DEVICE,
    ),
    _row(
        "alive/<component>",
        "subscribe",
        "liveliness token",
        "Which processes of the cell are connected.",
        READERS,
        EVERYBODY,
    ),
]


def check_chunk(text: str) -> str:
    """Returns `text` if it may stand between two slashes of a key.

    Raises:
        PayloadError: It is empty, has upper case, or characters other than ``a-z 0-9 . _ -``.
    """
    if not _CHUNK.fullmatch(text):
        raise PayloadError(
            f"'{text}' cannot be a part of a key: use lower-case letters, digits, '.', '_' and '-'.",
            chunk=text,
        )
    return text


def cell_prefix(site: str, cell: str) -> str:
    """The part that all keys of a cell share, without a slash at its end.

    Raises:
        PayloadError: A name cannot be a part of a key.
    """
    return f"pcmrs/{check_chunk(site)}/{check_chunk(cell)}"


def command_key(user: str, branch: str, operation: str) -> str:
    """The relative key on which `user` asks for an operation.

    Raises:
        PayloadError: A name cannot be a part of a key.
    """
    return "/".join(("cmd", *map(check_chunk, (user, branch, operation))))


def is_signed(key: str) -> bool:
    """Whether messages on a relative key are signed: what acts on the cell, but for Stop, which everybody may send."""
    return key.startswith(("cmd/", "teleop/"))


def named_in(key: str) -> str:
    """The name in a relative key, its second chunk: the user of ``stop/eve``, the device of ``dev/robot/cmd``."""
    return key.split("/")[1]


def split_command_key(key: str) -> tuple[str, str, str]:
    """User, branch and operation of a relative key that matches ``cmd/*/*/*``.

    Raises:
        PayloadError: A part is no name, such as a wildcard.
    """
    user, branch, operation = map(check_chunk, key.split("/")[1:])
    return user, branch, operation
