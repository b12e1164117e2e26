"""Runs seeded tasks: the only way in which the laboratory uses more than one processor."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from pcmrs_lab.scale._errors import TaskFailedError
from pcmrs_lab.scale._finished import FinishedTasks
from pcmrs_lab.scale._function import TaskFunction
from pcmrs_lab.scale._task_process import TaskReply, TaskRequest
from pcmrs_lab.scale._version import code_version

if TYPE_CHECKING:
    # Dask is imported only when it is used: that takes a second.
    from pcmrs_lab.scale._dask import DaskPool

__all__ = ["HERE", "ShowProgress", "TaskFailedError", "Workers", "run_tasks"]

T = TypeVar("T", bound=msgspec.Struct)
R = TypeVar("R")

ShowProgress = Callable[[str, int, int], None]
"""Called with the current step, and with how many of how many tasks are finished."""


@dataclass(frozen=True, slots=True)
class Workers:
    """Where tasks run.

    Attributes:
        number: Number of worker processes on this machine; a single one is this process.
        cluster: Address of the scheduler of a cluster, which replaces them; empty for none.
        finished: File of finished tasks, to which each is appended, and whose tasks are not run again; None for none.
    """

    number: int = 1
    cluster: str = ""
    finished: Path | None = None


HERE = Workers()
"""This process."""


def run_tasks(
    function: Callable[[list[T]], list[R]], tasks: Iterable[T], workers: Workers, at_once: int
) -> Generator[tuple[T, R], None, None]:
    """Run every task once, and return each with its result, in the order in which they finish.

    Args:
        function: Function of a module, with one argument ``tasks``. It must draw nothing but from the tasks' seeds.
        tasks: Tasks, different from each other. The next is taken when a worker may soon need it.
        workers: Where they run.
        at_once: Number of tasks in one request. It does not change the results.

    Yields:
        Task and result.

    Raises:
        ConfigurationError: The cluster or the file of finished tasks cannot be used.
        FileFormatError: The file of finished tasks has other contents.
        TaskFailedError: A task failed on a worker, or no worker could end it.
    """
    called: TaskFunction[T, R] = TaskFunction(function)
    with ExitStack() as stack:
        file = None
        if workers.finished is not None:
            file = stack.enter_context(FinishedTasks(workers.finished, called.name, code_version()))
        known: list[tuple[T, bytes]] = []
        requests = _requests(tasks, file, known, at_once)
        running = _here(called, requests)
        if workers.cluster or workers.number > 1:
            running = _on_dask(called.name, requests, stack.enter_context(_pool(workers)))
        for request, results in running:
            if file is not None:
                file.add([called.encode(task) for task in request], results)
            for task, result in zip(request, results, strict=True):
                yield task, called.decode(result)
            yield from ((task, called.decode(result)) for task, result in known)
            known.clear()
        yield from ((task, called.decode(result)) for task, result in known)


def _requests(
    tasks: Iterable[T], file: FinishedTasks | None, known: list[tuple[T, bytes]], at_once: int
) -> Iterator[list[T]]:
    """Return the tasks that are not finished, some at once; the others are put into `known`."""
    request: list[T] = []
    for task in tasks:
        result = None if file is None else file.get(TaskFunction.encode(task))
        if result is not None:
            known.append((task, result))
            continue
        request.append(task)
        if len(request) == at_once:
            yield request
            request = []
    if request:
        yield request


def _here(called: TaskFunction[T, R], requests: Iterator[list[T]]) -> Iterator[tuple[list[T], list[bytes]]]:
    for request in requests:
        yield request, called.call([called.encode(task) for task in request])


def _pool(workers: Workers) -> AbstractContextManager[DaskPool]:
    from pcmrs_lab.scale._dask import cluster_pool, local_pool

    return cluster_pool(workers.cluster) if workers.cluster else local_pool(workers.number)


def _on_dask(name: str, requests: Iterator[list[T]], pool: DaskPool) -> Iterator[tuple[list[T], list[bytes]]]:
    given: dict[int, list[T]] = {}

    def encoded() -> Iterator[tuple[int, bytes]]:
        for number, request in enumerate(requests):
            given[number] = request
            tasks = [TaskFunction.encode(task) for task in request]
            yield number, msgspec.msgpack.encode(TaskRequest(name, code_version(), tasks))

    for number, content in pool.run(encoded()):
        yield given.pop(number), _results(content)


def _results(content: bytes) -> list[bytes]:
    reply = msgspec.msgpack.decode(content, type=TaskReply)
    if reply.error:
        raise TaskFailedError(f"A task failed on a worker: {reply.error}", trace=reply.trace)
    return reply.results
