"""Keys below a cell's own that the bridge maps to topics, and the announcement of topics to it.

From the source of zenoh-plugin-ros2dds 1.x (ros2_utils.rs, liveliness_mgt.rs). With ``namespace: "/a/b"`` the key
``a/b/tf`` is the topic ``/tf``. If a ROS node subscribes, the bridge forwards the messages on that key; it shows a
topic to ROS earlier if it sees the liveliness token ``@/<id>/@ros2_lv/MP/<key>/<type>/<quality of service>``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of

PREFIX: Final = "ros2"
"""First part of all relative keys that the bridge maps."""

_RELIABLE, _VOLATILE, _TRANSIENT_LOCAL, _KEEP_LAST = 1, 0, 1, 0  # as CycloneDDS counts them
_SLASH: Final = "§"
_DEPTH: Final = 10
_NOT_ALLOWED = re.compile(r"[^A-Za-z0-9_]")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic that the cell publishes.

    Attributes:
        name: Name without the slash at its beginning.
        kind: Type of its messages, such as ``std_msgs/msg/String``.
    """

    name: str
    kind: str

    @property
    def key(self) -> str:
        """Key relative to the cell."""
        return f"{PREFIX}/{self.name}"

    @property
    def token(self) -> Callable[[str, str], str]:
        """Function that makes the liveliness token from a session's id and the cell's prefix."""
        return partial(_token, self)


JOINT_STATES: Final = Topic("joint_states", "sensor_msgs/msg/JointState")
TF: Final = Topic("tf", "tf2_msgs/msg/TFMessage")
TF_STATIC: Final = Topic("tf_static", "tf2_msgs/msg/TFMessage")
STATE: Final = Topic("state", "std_msgs/msg/String")

TOPICS: Final = (JOINT_STATES, TF, TF_STATIC, STATE)
"""Topics of every cell; the topic of a tracked body is announced with its first pose."""


def pose_topic(body: str) -> Topic:
    """Return the topic of a tracked body; characters that ROS does not allow become ``_``."""
    return Topic(f"pose/{_NOT_ALLOWED.sub('_', body)}", "geometry_msgs/msg/PoseStamped")


def tracker_key(name: str) -> str:
    """Return the key, relative to the cell, of the poses that ROS publishes on ``/tracker/<name>``."""
    return f"{PREFIX}/tracker/{name}"


def namespace(site: str, cell: str) -> str:
    """Return the value of the bridge's ``namespace``.

    Args:
        site: Name of the site.
        cell: Name of the cell.

    Raises:
        PayloadError: The site's or cell's name cannot be a part of a key.
    """
    return f"/{cell_prefix(site, cell)}/{PREFIX}"


def _token(topic: Topic, session: str, prefix: str) -> str:
    durability, depth = (_TRANSIENT_LOCAL, 1) if class_of(topic.key).kept else (_VOLATILE, _DEPTH)
    chunks = [text.replace("/", _SLASH) for text in (f"{prefix}/{topic.key}", topic.kind)]
    return f"@/{session}/@{PREFIX}_lv/MP/{'/'.join(chunks)}/:{_RELIABLE}:{durability}:{_KEEP_LAST},{depth}"
