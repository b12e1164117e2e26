"""A daemon with a saboteur inside: it does, on order, what only happens within a process.

    python -m pcmrs_lab.campaign.saboteur SOCKET python -m pcmrs.cli serve ...

Orders are datagrams to the Unix socket, each answered when it was carried out: ``block SECONDS`` keeps the event loop
busy; ``fail TASK`` makes what a named task waits for raise; ``eat BYTES`` takes
memory; ``tasks`` counts tasks.
"""

from __future__ import annotations

import asyncio
import runpy
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import uvloop

from pcmrs_lab.campaign.sham import is_sham

PROGRAM = "pcmrs_lab.campaign.saboteur"
ANSWERS_WITHIN = 10.0
"""A saboteur has done what it was told within this, s of the machine."""


def sabotaged(orders: Path) -> tuple[str, ...]:
    """The words before a daemon's command line that put a saboteur into it, listening at `orders`."""
    return sys.executable, "-m", PROGRAM, str(orders)


async def order(orders: Path, text: str) -> str:
    """Tells the saboteur what to do, and waits until it has done that; in a sham campaign it does nothing.

    Raises:
        TimeoutError: It has not within `ANSWERS_WITHIN`.
    """
    return "" if is_sham() else await asyncio.to_thread(_order, orders, text)


def _order(orders: Path, text: str) -> str:
    answer_to = orders.with_suffix(f".{threading.get_ident()}")
    answer_to.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asker:
        asker.bind(str(answer_to))
        asker.settimeout(ANSWERS_WITHIN)
        asker.sendto(text.encode(), str(orders))
        return asker.recv(1024).decode()


def main(words: Sequence[str]) -> None:
    """Runs the command line behind the first word, with orders taken at that."""
    orders, module = Path(words[0]), words.index("-m")
    loops: list[asyncio.AbstractEventLoop] = []
    make = uvloop.new_event_loop

    def remembered() -> uvloop.Loop:
        loop = make()
        loops.append(loop)
        return loop

    uvloop.new_event_loop = remembered
    threading.Thread(target=_obey, args=(orders, loops), daemon=True).start()
    sys.argv = ["pcmrs", *words[module + 2 :]]
    runpy.run_module(words[module + 1], run_name="__main__", alter_sys=True)


def _obey(orders: Path, loops: list[asyncio.AbstractEventLoop]) -> None:
    orders.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ears:
        ears.bind(str(orders))
        while True:
            text, asker = ears.recvfrom(1024)
            done: list[str] = []
            carried_out = threading.Event()
            loops[-1].call_soon_threadsafe(_carry_out, text.decode(), done, carried_out)
            carried_out.wait(ANSWERS_WITHIN)
            ears.sendto((done[0] if done else "not carried out").encode(), asker)


def _carry_out(text: str, done: list[str], carried_out: threading.Event) -> None:
    word, _, rest = text.partition(" ")
    try:
        done.append(ORDERS[word](rest))
    finally:
        carried_out.set()


def _block(seconds: str) -> str:
    time.sleep(float(seconds))
    return "blocked"


def _fail(name: str) -> str:
    for task in asyncio.all_tasks():
        waits_for = getattr(task, "_fut_waiter", None)
        if task.get_name() == name and waits_for is not None and not waits_for.done():
            waits_for.set_exception(RuntimeError("injected by the campaign"))
            return "failed"
    return "no such task"


def _eat(size: str) -> str:
    _eaten.append(b"\1" * int(size))
    return "eaten"


_eaten: list[bytes] = []


def _tasks(_: str) -> str:
    return str(len(asyncio.all_tasks()))


ORDERS: dict[str, Callable[[str], str]] = {"block": _block, "eat": _eat, "fail": _fail, "tasks": _tasks}

if __name__ == "__main__":
    main(sys.argv[1:])
