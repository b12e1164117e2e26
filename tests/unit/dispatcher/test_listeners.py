"""Listeners learn of everything at once, and cannot break the dispatcher."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.dispatcher import DispatcherListener
from pcmrs.messages import DeviceEvent
from tests.unit.dispatcher.dispatcher_fakes import RETRACTED, Bench, code


@pytest.mark.parametrize("fails", ["listener", "publisher"])
async def test_stop_works_although_a_listener_fails(bench: Bench, fails: str) -> None:
    class Failing(DispatcherListener):
        def on_stop(self) -> None:
            if fails == "listener":
                raise RuntimeError("The test wants it to fail.")

        def on_publish(self, _message: object) -> None:
            if fails == "publisher":
                raise RuntimeError("The test wants it to fail.")

    reported: list[str] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: reported.append(context["message"]))
    await bench.go(RETRACTED)
    bench.script.hang("placement.approach")
    motion = await bench.begin("placement.approach")
    bench.dispatcher.add_listener(Failing())
    assert await bench.dispatcher.stop("test:operator")
    assert code(await motion) == "stopped"
    assert reported


async def test_listeners_learn_of_every_stop_before_anything_else_runs(bench: Bench) -> None:
    told: list[bool] = []

    class Listener(DispatcherListener):
        def on_stop(self) -> None:
            told.append(bench.dispatcher.snapshot().latched)

    bench.dispatcher.add_listener(Listener())
    await bench.dispatcher.stop("test:operator")
    await bench.dispatcher.report(DeviceEvent(device="robot", code="force_limit", text="Too strong.", danger=True))
    assert told == [True, True]
