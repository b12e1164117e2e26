"""The keys of a cell: the table of all keys, and functions that build and split them.

A key is ``pcmrs/<site>/<cell>/`` and a relative key such as ``state/fsm``. Everything but the session itself works
with relative keys.
"""

from __future__ import annotations

import re
from typing import Final, Literal

from pcmrs.errors import PayloadError
from pcmrs.messages import Message
from pcmrs.messages.clipping import shortened
from pcmrs.messages.identity import COMMANDING, HOLDING, Role

MAX_CHUNK: Final = 64
"""Limit of one part of a key, characters; no branch, operation or user has a longer name."""
_CHUNK = re.compile(rf"[a-z0-9][a-z0-9._-]{{0,{MAX_CHUNK - 1}}}")

Use = Literal["query", "put", "put or query", "subscribe"]


class KeyInfo(Message, frozen=True, kw_only=True, omit_defaults=False):
    """One row of the key table, as a client outside the daemon sees it.

    Attributes:
        key: Relative key; ``<name>`` stands for one chunk, ``<user>`` for the name of the user.
        use: Use of the key by a client.
        payload: Type that is sent and, after an arrow, type of the reply.
        text: Purpose of the key.
        users: Roles that may use the key.
        owners: Roles that serve or publish it.
    """

    key: str
    use: Use
    payload: str
    text: str
    users: tuple[Role, ...]
    owners: tuple[Role, ...]


class KeyTable(Message, frozen=True, kw_only=True, omit_defaults=False):
    """The answer to ``svc/keys``.

    Attributes:
        prefix: Prefix of all keys of the cell.
        keys: Rows of the table.
    """

    prefix: str
    keys: list[KeyInfo]


EVERYBODY: Final[tuple[Role, ...]] = ("operator", "planner", "viewer", "device", "teleoperator", "daemon")
READERS: Final[tuple[Role, ...]] = ("operator", "planner", "viewer", "teleoperator", "daemon")
DAEMON: Final[tuple[Role, ...]] = ("daemon",)
DEVICE: Final[tuple[Role, ...]] = ("device",)
SCENE: Final[tuple[Role, ...]] = ("scene",)
SENT_ON_SITE: Final[tuple[Role, ...]] = ("device", "daemon")
"""Owners of what devices publish. To a router, the daemon publishes for the devices on its own machine."""


TEXT_COPIES: Final = {"state/fsm": "json/state/fsm", "state/event": "json/state/event"}
"""Keys whose messages are also sent as JSON text, for clients that cannot read MessagePack, each with the other key."""


def _row(
    key: str, use: Use, payload: str, text: str, users: tuple[Role, ...], owners: tuple[Role, ...] = DAEMON
) -> KeyInfo:
    return KeyInfo(key=key, use=use, payload=payload, text=text, users=users, owners=owners)


KEYS = [
    _row(
        "cmd/<user>/<branch>/<operation>",
        "put or query",
        '{"id"?, "sent"?, "ttl"?, "arguments"?} -> Verdict',
        "Sends a command. A query is answered with the verdict; the verdict on a put appears on state/event.",
        COMMANDING,
    ),
    # The robot's node subscribes to it as well, so that Stop works without the daemon.
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
    _row("json/state/fsm", "subscribe", "Snapshot as JSON", "state/fsm as text, while somebody subscribes.", READERS),
    _row(
        "json/state/event",
        "subscribe",
        "Verdict | DeviceEvent as JSON",
        "state/event as text, while somebody subscribes; the verdict on a put.",
        READERS,
    ),
    # A detector needs the joints: it tells the arm from what does not belong in the scene.
    _row("state/joints", "subscribe", "JointState", "Measured joints of the arm.", (*READERS, *SCENE), SENT_ON_SITE),
    _row(
        "state/pose/<body>",
        "subscribe",
        "BodyPose",
        "Pose of a tracked body in the tracker frame.",
        READERS,
        SENT_ON_SITE,
    ),
    _row("state/flags", "subscribe", "Flags", "The flags that mirror the states, for displays.", READERS),
    _row("state/target", "subscribe", "Target", "Planned tool pose in the image, and the registration.", READERS),
    _row("state/data", "subscribe", "ProcedureDataView", "The answer of svc/data, after each change.", READERS),
    _row("state/epoch", "subscribe", "Epoch", "Measured signal of a muscle around each pulse.", READERS),
    _row(
        "state/health", "subscribe", "Health", "The answer of svc/health, every few seconds, for recordings.", READERS
    ),
    _row("teleop/<user>", "put", "TeleopSetpoint", "Set points of the user who has engaged the clutch.", HOLDING),
    _row("scene/<user>", "put", "SceneEvent", "Events that a detector recognises in the scene.", SCENE),
    _row("state/teleop", "subscribe", "TeleopStatus", "Status of the guidance, while the tool is guided.", READERS),
    _row("svc/snapshot", "query", "nothing -> Snapshot", "The present state, for clients that join late.", READERS),
    _row(
        "svc/health", "query", "nothing -> Health", "Health of the daemon, with reasons if it is not healthy.", READERS
    ),
    _row(
        "svc/journal",
        "query",
        '{"after"?, "before"?, "limit"?} -> JournalPage',
        "Rows of the journal, a page at a time.",
        ("operator", "viewer", "daemon"),
    ),
    _row("svc/setup/<user>", "query", "nothing -> Setup", "Setup for a console: workflow, arm, tool, body.", READERS),
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
        "Verdict that a command would get now; nothing is done.",
        COMMANDING,
    ),
    _row(
        "svc/next",
        "query",
        '{"operation"?} -> NextStep',
        "The way on to the next stage of the procedure, or to an operation.",
        READERS,
    ),
    _row("svc/keys", "query", "nothing -> KeyTable", "This table.", READERS),
    _row("dev/<device>/cmd", "query", "DeviceRequest -> DeviceReply", "Calls a method of a device.", DAEMON, DEVICE),
    _row("dev/<device>/state", "subscribe", "DeviceHealth", "Health of a device.", READERS, SENT_ON_SITE),
    _row("dev/<device>/beat", "subscribe", "NodeBeat", "Heartbeats of a device's node.", DAEMON, DEVICE),
    _row("daemon/beat", "subscribe", "Beat", "Signs of life of the daemon's loop.", DEVICE),
    _row("daemon/run", "query", "nothing -> bytes", "Proves which messages are of the daemon's present run.", DEVICE),
    _row("daemon/event", "subscribe", "DeviceEvent", "Events of the daemon's own processes.", DAEMON),
    _row("dev/robot/setpoint", "subscribe", "JointSetpoint", "Set points of a servo session.", DEVICE),
    _row("dev/tracker/beep", "subscribe", "Beeps", "Beeps for the person with the pointer.", DEVICE),
    _row("dev/<device>/event", "subscribe", "DeviceEvent", "Events that a device reports by itself.", DAEMON, DEVICE),
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
        SENT_ON_SITE,
        DEVICE,
    ),
    _row(
        "alive/<component>",
        "subscribe",
        "liveliness token",
        "Connected processes of the cell.",
        READERS,
        EVERYBODY,
    ),
]


def check_chunk(text: str) -> str:
    """Return `text` if it is a valid chunk of a key: the part between two slashes.

    Raises:
        PayloadError: The text is empty, too long, or has upper case or characters other than ``a-z 0-9 . _ -``.
    """
    if not _CHUNK.fullmatch(text):
        shown = shortened(text, MAX_CHUNK)
        raise PayloadError(
            f"'{shown}' cannot be a part of a key: use 1 to {MAX_CHUNK} lower-case letters, digits, '.', '_' and '-'.",
            chunk=shown,
        )
    return text


def cell_prefix(site: str, cell: str) -> str:
    """Return the prefix of all keys of a cell, without a slash at its end.

    Args:
        site: Name of the site.
        cell: Name of the cell.

    Raises:
        PayloadError: A name cannot be a part of a key.
    """
    return f"pcmrs/{check_chunk(site)}/{check_chunk(cell)}"


def command_key(user: str, branch: str, operation: str) -> str:
    """Return the relative key of a command.

    Args:
        user: Name of the user who sends it.
        branch: Branch of the workflow.
        operation: Operation of that branch.

    Raises:
        PayloadError: A name cannot be a part of a key.
    """
    return "/".join(("cmd", *map(check_chunk, (user, branch, operation))))


def is_signed(key: str) -> bool:
    """Return True for a relative key whose messages are signed: all that act on the cell, except Stop.

    Everyone may send a Stop.
    """
    return key.startswith(("cmd/", "teleop/"))


def named_in(key: str) -> str:
    """Return the second chunk of a relative key: the user of ``stop/eve``, the device of ``dev/robot/cmd``."""
    return key.split("/")[1]


def split_command_key(key: str) -> tuple[str, str, str]:
    """Return user, branch and operation of a relative key that matches ``cmd/*/*/*``.

    Raises:
        PayloadError: A part is not a name, such as a wildcard.
    """
    user, branch, operation = map(check_chunk, key.split("/")[1:])
    return user, branch, operation
