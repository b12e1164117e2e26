"""Error of a task on a worker."""

from __future__ import annotations

from pcmrs.errors import PcmrsError


class TaskFailedError(PcmrsError):
    """A task raised an error on a worker, or no worker could end it."""

    code = "task_failed"
