"""CDR messages of bridges to ROS 2: each input is a message of its kind, or is refused.

python -m fuzz.cdr -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.ros2.cdr", "pycdr2"):
    from pcmrs.errors import PayloadError
    from pcmrs.ros2.cdr import Pose, PoseStamped, RosJointState, String, TFMessage, decode

KINDS = (PoseStamped, TFMessage, RosJointState, String, Pose)


def one(data: bytes) -> None:
    """Decode a message; the first byte selects its kind."""
    kind = KINDS[data[0] % len(KINDS) if data else 0]
    try:
        message = decode(data[1:], kind)
    except PayloadError:
        return
    assert isinstance(message, kind)


if __name__ == "__main__":
    run(one)
