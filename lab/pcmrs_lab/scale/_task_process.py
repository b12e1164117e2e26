"""Process that runs tasks, and nothing else: ``python -m pcmrs_lab.scale._task_process``.

A worker of Dask may not run them itself. A simulated session replaces the randomness of the operating system, from
which the worker's own threads take the keys of their connections: sessions would differ from run to run, and keys would
be known. Besides, only the main thread of a process gets signals and starts daemons that outlive no thread.

Requests arrive on standard input, replies leave on standard output; each is 4 bytes with its length, and MessagePack.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from queue import SimpleQueue
from types import FrameType
from typing import IO

import msgspec

from pcmrs_lab.scale._function import TaskFunction
from pcmrs_lab.scale._version import code_version

LENGTH = 4
"""Bytes of the length of a message."""
END_TIME = 15.0
"""Time in which a task ends its daemons after its worker has ended, s of the machine."""


class TaskRequest(msgspec.Struct, frozen=True, array_like=True):
    """Tasks to run.

    Attributes:
        function: Name of the function.
        version: Version of the code that the results must come from.
        tasks: Tasks, as JSON.
    """

    function: str
    version: str
    tasks: list[bytes]


class TaskReply(msgspec.Struct, frozen=True, array_like=True):
    """Results of a request.

    Attributes:
        results: Results in the order of the tasks, MessagePack; empty if there was an error.
        error: What was wrong; empty if nothing.
        trace: Where, for a report of the defect.
    """

    results: list[bytes]
    error: str = ""
    trace: str = ""


def send(stream: IO[bytes], message: bytes) -> None:
    """Send a message.

    Args:
        stream: Pipe to the other process.
        message: MessagePack.
    """
    stream.write(len(message).to_bytes(LENGTH, "big") + message)
    stream.flush()


def receive(stream: IO[bytes]) -> bytes | None:
    """Receive a message; None at the end of the stream.

    Args:
        stream: Pipe from the other process.
    """
    head = stream.read(LENGTH)
    if len(head) < LENGTH:
        return None
    length = int.from_bytes(head, "big")
    message = stream.read(length)
    return message if len(message) == length else None


def answer(request: TaskRequest) -> TaskReply:
    """Run the tasks of a request; their error is the reply."""
    if request.version != code_version():
        text = "This worker has another version of PCMRS, or of the packages that it computes with, than the client."
        return TaskReply([], text)
    try:
        return TaskReply(TaskFunction.of(request.function).call(request.tasks))
    except Exception as error:  # the client raises it
        return TaskReply([], f"{type(error).__name__}: {error}", traceback.format_exc())


def main() -> None:
    """Answer requests until standard input ends, and then end within `END_TIME`, whatever is running."""
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    os.dup2(2, 1)  # what a task prints is no reply
    signal.signal(signal.SIGINT, _interrupt)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    waiting: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_read, args=(requests, waiting), name="requests", daemon=True).start()
    try:
        while True:
            request = msgspec.msgpack.decode(waiting.get(), type=TaskRequest)
            send(replies, msgspec.msgpack.encode(answer(request)))
    except (KeyboardInterrupt, BrokenPipeError):
        sys.exit(0)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    os.dup2(0, 2)  # nobody waits for what an interrupted task complains about
    raise KeyboardInterrupt


def _read(requests: IO[bytes], waiting: SimpleQueue[bytes]) -> None:
    while (request := receive(requests)) is not None:
        waiting.put(request)
    # The worker has ended, perhaps killed: the task removes its files and daemons, as after Ctrl-C.
    last = threading.Timer(END_TIME, os.killpg, (os.getpgid(0), signal.SIGKILL))
    last.daemon = True
    last.start()
    os.kill(os.getpid(), signal.SIGINT)


if __name__ == "__main__":
    main()
