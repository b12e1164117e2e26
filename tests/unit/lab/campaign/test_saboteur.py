"""A saboteur in a daemon carries out its orders, and always lets the daemon run on."""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import uvloop

from pcmrs_lab.campaign import saboteur
from pcmrs_lab.campaign.saboteur import order, sabotaged
from pcmrs_lab.campaign.sham import sham


def carried_out(text: str) -> list[str]:
    done: list[str] = []
    ended = threading.Event()
    saboteur._carry_out(text, done, ended)
    assert ended.is_set()
    return done


async def test_tasks_are_counted() -> None:
    other = asyncio.create_task(asyncio.sleep(60.0))
    assert carried_out("tasks") == ["2"]
    other.cancel()


async def test_a_named_task_fails_where_it_waits() -> None:
    waiting = asyncio.create_task(asyncio.Event().wait(), name="beat")
    await asyncio.sleep(0)
    assert carried_out("fail clock") == ["no such task"]
    assert not waiting.done()
    assert carried_out("fail beat") == ["failed"]
    with pytest.raises(RuntimeError, match="injected by the campaign"):
        await waiting


def test_the_loop_is_blocked_for_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr("time.sleep", slept.append)
    assert carried_out("block 2.5") == ["blocked"]
    assert slept == [2.5]


def test_memory_is_taken_for_good(monkeypatch: pytest.MonkeyPatch) -> None:
    eaten: list[bytes] = []
    monkeypatch.setattr(saboteur, "_allocated", eaten)
    assert carried_out("eat 1000") == ["eaten"]
    assert sum(map(len, eaten)) == 1000


@pytest.mark.parametrize("text", ["burn", "block soon", ""])
def test_an_order_that_fails_is_still_ended(text: str) -> None:
    done: list[str] = []
    ended = threading.Event()
    with suppress(KeyError, ValueError):
        saboteur._carry_out(text, done, ended)
    assert ended.is_set()
    assert done == [], "it is answered as not carried out"


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as made:
        made.bind(str(tmp_path / "orders"))
        made.settimeout(5.0)
        yield made


async def test_an_order_waits_for_its_answer(tmp_path: Path, listener: socket.socket) -> None:
    def answer() -> bytes:
        text, sender = listener.recvfrom(1024)
        listener.sendto(b"7", sender)
        return text

    found, text = await asyncio.gather(order(tmp_path / "orders", "tasks"), asyncio.to_thread(answer))
    assert (found, text) == ("7", b"tasks")


async def test_an_order_that_is_not_answered_is_late(
    tmp_path: Path, listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(saboteur, "ANSWERS_WITHIN", 0.01)
    for _ in range(2):
        with pytest.raises(TimeoutError):
            await order(tmp_path / "orders", "tasks")
    assert listener.recv(1024) == b"tasks"


async def test_nothing_is_ordered_in_a_sham_campaign(tmp_path: Path) -> None:
    with sham():
        assert await order(tmp_path / "nobody", "eat 1000") == ""


def test_the_command_line_of_the_daemon_is_run_as_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ran: list[Any] = []
    made = uvloop.new_event_loop

    def run(module: str, **_: Any) -> None:
        ran.extend((module, sys.argv[1:]))
        uvloop.new_event_loop().close()

    class Thread:
        def __init__(self, *, target: Any, args: tuple[Path, list[Any]], daemon: bool) -> None:
            ran.append(args)

        def start(self) -> None:
            pass

    monkeypatch.setattr(uvloop, "new_event_loop", made)
    monkeypatch.setattr(sys, "argv", list(sys.argv))
    monkeypatch.setattr("runpy.run_module", run)
    monkeypatch.setattr(threading, "Thread", Thread)
    orders = tmp_path / "orders"
    words = [*sabotaged(orders)[3:], "python", "-m", "pcmrs.cli", "serve", "--set", "a=-m"]
    saboteur.main(words)
    (place, loops), module, arguments = ran
    assert (place, module, arguments) == (orders, "pcmrs.cli", ["serve", "--set", "a=-m"])
    assert len(loops) == 1, "orders are carried out in the daemon's loop"
