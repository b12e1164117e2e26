"""Where things are: keys below a cell's own, which the bridge maps to topics, and how a topic is announced to it.

From the source of zenoh-plugin-ros2dds 1.x (ros2_utils.rs, liveliness_mgt.rs). With ``namespace: "/a/b"`` the key
``a/b/tf`` is the topic ``/tf``. Where a ROS node subscribes, the bridge passes on what comes on that key; it shows a
topic to ROS before that when it sees the liveliness token ``@/<id>/@ros2_lv/MP/<key>/<type>/<quality of service>``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of

ROOM: Final = "ros2"
"""First part of all relative keys that a bridge may know."""

_RELIABLE, _VOLATILE, _TRANSIENT_LOCAL, _KEEP_LAST = 1, 0, 1, 0  # as CycloneDDS counts them
_SLASH: Final = "§"
_DEPTH: Final = 10
_NO_LETTER = re.compile(r"[^A-Za-z0-9_]")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic that the cell publishes.

    Attributes:
        name: Without the slash at its beginning.
        kind: Type of its messages, such as ``std_msgs/msg/String``.
    """

    name: str
    kind: str

    @property
    def key(self) -> str:
        """Relative to the cell."""
        return f"{ROOM}/{self.name}"

    @property
    def token(self) -> Callable[[str, str], str]:
        """Makes the liveliness token from a session's id and the cell's prefix."""
        return partial(_token, self)


JOINT_STATES: Final = Topic("joint_states", "sensor_msgs/msg/JointState")
TF: Final = Topic("tf", "tf2_msgs/msg/TFMessage")
TF_STATIC: Final = Topic("tf_static", "tf2_msgs/msg/TFMessage")
STATE: Final = Topic("state", "std_msgs/msg/String")

TOPICS: Final = (JOINT_STATES, TF, TF_STATIC, STATE)
"""Those of every cell; a topic of each tracked body comes with its first pose."""


def pose_topic(body: str) -> Topic:
    """Of a tracked body; what ROS allows in no name is ``_`` there."""
    return Topic(f"pose/{_NO_LETTER.sub('_', body)}", "geometry_msgs/msg/PoseStamped")


def tracker_key(name: str) -> str:
    """Where the poses come that ROS publishes on ``/tracker/<name>``; relative to the cell."""
    return f"{ROOM}/tracker/{name}"


def namespace(site: str, cell: str) -> str:
    """What the bridge's ``namespace`` has to be.

    Raises:
        PayloadError: The site's or cell's name cannot be a part of a key.
    """
    return f"/{cell_prefix(site, cell)}/{ROOM}"


def _token(topic: Topic, session: str, prefix: str) -> str:
    durability, depth = (_TRANSIENT_LOCAL, 1) if class_of(topic.key).kept else (_VOLATILE, _DEPTH)
    chunks = [text.replace("/", _SLASH) for text in (f"{prefix}/{topic.key}", topic.kind)]
    return f"@/{session}/@{ROOM}_lv/MP/{'/'.join(chunks)}/:{_RELIABLE}:{durability}:{_KEEP_LAST},{depth}"
