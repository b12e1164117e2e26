"""What a worker of Dask runs: it hands tasks to the process that runs them."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from pcmrs_lab.scale._task_process import receive, send

_own = threading.local()


class TaskProcessEndedError(Exception):
    """The process of this worker has ended within a task; Dask runs the task again."""


def run_request(request: bytes) -> bytes:
    """Run a request in the process of this thread of the worker, and return the reply.

    Args:
        request: A `TaskRequest`, MessagePack.

    Returns:
        A `TaskReply`, MessagePack.

    Raises:
        TaskProcessEndedError: The process has ended within the task.
    """
    process: subprocess.Popen[bytes] | None = getattr(_own, "process", None)
    if process is None:
        process = _own.process = _start()
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        send(process.stdin, request)
        reply = receive(process.stdout)
    except BrokenPipeError:
        reply = None
    if reply is None:
        _own.process = None
        process.stdin.close()
        process.stdout.close()
        raise TaskProcessEndedError(f"The process of a task has ended with status {process.wait()}.")
    return reply


def _start() -> subprocess.Popen[bytes]:
    """Start the process: it imports from where this one does, and Ctrl-C in a terminal does not reach it."""
    command = [sys.executable, "-P", "-m", "pcmrs_lab.scale._task_process"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
    )
