"""Process in which motions are planned: ``python -m pcmrs.workflows.planning_process``.

It reads its settings and then requests from its standard input, and writes an answer to each request. All messages are
pickled, with their length in front. The process ends when its standard input ends, and therefore with the daemon.
"""

from __future__ import annotations

import os
import pickle
import struct
import sys
from collections.abc import Iterator
from typing import Any, BinaryIO

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import Reason
from pcmrs.workflows.opening import open_verified
from pcmrs.workflows.planning import PlanAnswer, PlanningCell, PlanningSettings

HEADER = struct.Struct("<QI")
"""Number of a request, and the length of its content. Number 0 carries the settings, and the answer that the process is
ready."""


def frame_message(number: int, content: bytes) -> bytes:
    """Return a message with its header.

    Args:
        number: Number of the request.
        content: Pickled content.
    """
    return HEADER.pack(number, len(content)) + content


def main() -> None:
    """Answer requests until standard input ends."""
    requests = sys.stdin.buffer
    # Output that a user's checks print must not mix with the answers.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    messages = _messages(requests)
    first = next(messages, None)
    if first is None:
        return
    settings: PlanningSettings = first[1]
    arm = ArmModel(find_arm(settings.arm))
    workflow = open_verified(settings.workflow, settings.blueprint)
    cell = PlanningCell(workflow, settings.procedure, arm, settings.surface, settings.mounting)
    _write(answers, 0, None)
    for number, request in messages:
        _write(answers, number, cell.answer(request))


def _messages(stream: BinaryIO) -> Iterator[tuple[int, Any]]:
    """Yield number and content of each message until the stream ends."""
    while len(head := stream.read(HEADER.size)) == HEADER.size:
        number, length = HEADER.unpack(head)
        yield number, pickle.loads(stream.read(length))  # noqa: S301  # of our parent


def _write(answers: BinaryIO, number: int, answer: PlanAnswer | None) -> None:
    answers.write(frame_message(number, _pickled(answer)))
    answers.flush()


def _pickled(answer: PlanAnswer | None) -> bytes:
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # a user's check may return any type
        text = f"The results of its checks cannot be sent to the daemon: {error}. Register them with check."
        refused = Reason(code="check_raised", text=text)
        return pickle.dumps(PlanAnswer(refused, None, {}, []), pickle.HIGHEST_PROTOCOL)


if __name__ == "__main__":
    main()
