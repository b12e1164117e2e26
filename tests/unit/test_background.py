"""Background tasks have an owner, and their failures go where the owner's policy says."""

from __future__ import annotations

import asyncio
from typing import Any

from structlog.testing import capture_logs

from pcmrs.background import BackgroundTasks, logged_as
from pcmrs.testing.clock import settle


async def fail() -> None:
    raise RuntimeError("The test wants it to fail.")


async def test_failure_goes_to_the_policy_and_cancellation_does_not() -> None:
    failed: list[tuple[asyncio.Task[Any], BaseException]] = []
    tasks = BackgroundTasks(lambda task, error: failed.append((task, error)))
    failing, waiting = tasks.spawn(fail()), tasks.spawn(asyncio.sleep(3600.0))
    await settle()
    await tasks.close()
    assert [task for task, _ in failed] == [failing]
    assert (waiting.cancelled(), len(tasks)) == (True, 0)


async def test_by_default_the_loop_gets_a_failure() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))
    tasks = BackgroundTasks()
    tasks.spawn(fail())
    await tasks.wait()
    await settle()
    assert [str(context["exception"]) for context in reported] == ["The test wants it to fail."]


async def test_a_failure_can_be_logged() -> None:
    tasks = BackgroundTasks(logged_as("some_task_failed"))
    with capture_logs() as logs:
        tasks.spawn(fail())
        await tasks.wait()
        await settle()
    assert [entry["event"] for entry in logs] == ["some_task_failed"]


async def test_waiting_includes_tasks_that_are_spawned_meanwhile() -> None:
    tasks, done = BackgroundTasks(), []

    async def first() -> None:
        await asyncio.sleep(0)
        tasks.spawn(second())

    async def second() -> None:
        await asyncio.sleep(0)
        done.append("second")

    tasks.spawn(first())
    await tasks.wait()
    assert done == ["second"]
