"""String commands, their verdicts and the streams, as bytes and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from .poses import Pose

MAX_BYTES = 256
NAME_LENGTH = 16
DECISIONS = ("accepted", "rejected", "failed")

REASONS = {
    "bad_series": "a landmark came twice or out of range; send all of them again",
    "busy": "something that excludes it is running; wait until it has ended",
    "clock_ahead": "the clock of this machine is ahead of the daemon's; set both",
    "counter_not_kept": "the daemon cannot write to its disk",
    "hold_not_confirmed": "the robot has not confirmed that it stands: USE THE EMERGENCY STOP",
    "id_reused": "its number was used before; connect again",
    "incomplete_series": "landmarks were lost on the way; send all of them again",
    "internal_error": "the daemon failed; look at its log",
    "invalid_in_state": "the workflow does not allow it in this state",
    "latched": "Stop is latched; an operator has to acknowledge it first",
    "lease_held": "somebody else holds the cell",
    "no_answer": "no answer; unknown whether it was done",
    "no_data": "there is nothing to read now",
    "no_lease": "nobody holds the cell",
    "no_plan": "no tool pose is planned",
    "not_allowed": "this client may not give this command (gateway.peers, allow)",
    "nobody_listens": "the daemon's port is closed; unknown whether it was done",
    "not_registered": "the body is not registered",
    "outcome_unknown": "the daemon does not know how it ended; look at the robot",
    "over_rate": "this client sends too much",
    "plan_not_accepted": "the last plan was not accepted; send one that is, then approach",
    "pose_missing": "the tracker does not see what it has to see",
    "pose_stale": "the tracker's last pose is too old",
    "queue_full": "too many commands wait",
    "residual_too_large": "the landmarks do not fit the body well enough",
    "robot_disconnected": "the robot is not connected",
    "role_not_allowed": "this client's role may not do it (gateway.peers, role)",
    "rotation_too_old": "the second half of the tool pose came too late; send it again",
    "stopped": "Stop came",
    "too_old": "it came more than 2 s late, or the clock of this machine is behind the daemon's; set both",
    "tre_too_large": "the error to be expected at the target is too large",
    "wrong_unit": "the numbers look like metres for millimetres, or the reverse",
}
"""What frequent reason codes mean; the wire has the code only."""


class MessageError(ValueError):
    """Bytes that are no message, or values that make none."""


@dataclass(frozen=True)
class Verdict:
    """What became of a command.

    Attributes:
        decision: ``accepted``, ``rejected``, ``failed``, or ``unknown``: no answer came.
        results: In the units of the wire.
    """

    decision: str
    branch: str
    state: str
    reason: str | None = None
    results: tuple[float, ...] = field(default=())

    @property
    def accepted(self) -> bool:
        """True if it was done."""
        return self.decision == "accepted"


@dataclass(frozen=True)
class Reading:
    """One datagram of a stream.

    Attributes:
        kind: ``tool``: pose of the tool in the image; ``tip``: the pointer's tip there, (3,), mm; ``tool_points``: two
            points of a tool pose from mixed reality, (6,), mm.
    """

    kind: str
    value: Pose | tuple[float, ...]


_STREAMS = {"__msg_pose_": ("tool", 7), "__msg_point_": ("tip", 3), "__msg_toolpose_": ("tool_points", 6)}


def explain(verdict: Verdict) -> str:
    """A sentence for people: what was decided, where, and why."""
    where = f" in {verdict.branch} {verdict.state}" if verdict.branch else ""
    if verdict.reason is None:
        return f"{verdict.decision}{where}"
    meaning = REASONS.get(verdict.reason)
    return f"{verdict.decision}{where}: {verdict.reason}" + (f" ({meaning})" if meaning else "")


def command(name: str, *values: float, number: int) -> bytes:
    """The datagram of a command that is answered with a verdict.

    Args:
        name: Its 16 characters.
        *values: Indices as int; m, rad or parts of a quaternion as float.
        number: Its number, by which a repeat is known.

    Raises:
        MessageError: A value is not finite, or the datagram would be too long.
    """
    if not all(math.isfinite(value) for value in values):
        raise MessageError(f"{name} takes finite numbers, not {values}.")
    tokens = [f"{value:02d}" if isinstance(value, int) else repr(float(value)) for value in values]
    datagram = ("_".join([name, *tokens, f"#{number}"]) + ";").encode("ascii")
    if len(name) != NAME_LENGTH or len(datagram) > MAX_BYTES:
        raise MessageError(f"{datagram!r} is no command: a name of 16 characters, and 256 bytes in all.")
    return datagram


def parse_verdict(data: bytes) -> tuple[int, Verdict]:
    """Number of the command, and its verdict.

    Raises:
        MessageError: It is no verdict.
    """
    try:
        text = data.decode("ascii")
        number, decision, branch, state, *rest = text[: text.index(";")].split("_", 4)
        results = tuple(map(float, rest[0].split("_"))) if decision == "accepted" and rest else ()
        reason = rest[0] if decision != "accepted" and rest else None
        if decision not in DECISIONS:
            raise MessageError(f"{decision!r} is no decision.")
        return int(number), Verdict(decision, branch.replace("-", "_"), state.replace("-", "_"), reason, results)
    except ValueError:
        raise MessageError(f"{data[:60]!r} is no verdict.") from None


def parse_stream(data: bytes) -> Reading:
    """One datagram of a stream.

    Raises:
        MessageError: It is none.
    """
    text = data.decode("ascii", "replace")
    for prefix, (kind, count) in _STREAMS.items():
        if text.startswith(prefix):
            numbers = _numbers(text[len(prefix) :])
            if len(numbers) == count:
                return Reading(kind, Pose.near(numbers[:3], numbers[3:]) if kind == "tool" else numbers)
    raise MessageError(f"{data[:60]!r} is not a message of a stream.")


def _numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(map(float, text.split("_")))
    except ValueError:
        numbers = ()
    return numbers if all(map(math.isfinite, numbers)) else ()


def metres(millimetres: Sequence[float]) -> list[float]:
    """Lengths as commands have them."""
    return [float(value) * 1e-3 for value in millimetres]
