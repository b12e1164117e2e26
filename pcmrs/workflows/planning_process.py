"""The process in which motions are planned: ``python -m pcmrs.workflows.planning_process``.

It reads the settings as a line of JSON from its standard input, then requests, and writes an answer to each; both are
pickled, with their length in front. It ends with its standard input, and so with the daemon.
"""

from __future__ import annotations

import os
import pickle
import struct
import sys
from typing import BinaryIO

import msgspec

from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import Reason
from pcmrs.workflows.opening import open_workflow
from pcmrs.workflows.planning import PlanAnswer, PlanningCell, PlanningSettings, PlanRequest

HEAD = struct.Struct("<QI")
"""Number of a request, and the length of what follows. Number 0 is the process's own: it is ready."""


def framed(number: int, content: bytes) -> bytes:
    """Return a message with its head."""
    return HEAD.pack(number, len(content)) + content


def main() -> None:
    """Answers until standard input ends."""
    requests = sys.stdin.buffer
    # What a user's checks print must not get between the answers.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    settings = msgspec.json.decode(requests.readline(), type=PlanningSettings)
    cell = PlanningCell(open_workflow(settings.workflow), settings.procedure, ArmModel(find_arm(settings.arm)))
    _write(answers, 0, None)
    while len(head := requests.read(HEAD.size)) == HEAD.size:
        number, length = HEAD.unpack(head)
        request: PlanRequest = pickle.loads(requests.read(length))  # noqa: S301  # of our parent
        _write(answers, number, cell.answer(request))


def _write(answers: BinaryIO, number: int, answer: PlanAnswer | None) -> None:
    answers.write(framed(number, _pickled(answer)))
    answers.flush()


def _pickled(answer: PlanAnswer | None) -> bytes:
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # of a user's check, whose types are the user's
        text = f"What its checks have found cannot be sent to the daemon: {error}. Register them with check."
        refused = Reason(code="check_raised", text=text)
        return pickle.dumps(PlanAnswer(refused, None, {}, []), pickle.HIGHEST_PROTOCOL)


if __name__ == "__main__":
    main()
