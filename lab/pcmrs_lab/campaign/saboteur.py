"""Daemon with a saboteur inside: on order it causes faults that only happen within a process.

    python -m pcmrs_lab.campaign.saboteur SOCKET python -m pcmrs.cli serve ...

Orders are datagrams to the Unix socket, each answered when it was carried out: ``block SECONDS`` blocks the event
loop; ``fail TASK`` raises an error in the future that a named task awaits; ``eat BYTES`` takes memory; ``tasks`` counts
tasks.
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
"""Time within which a saboteur has carried out an order, s of the machine."""


def sabotaged(orders: Path) -> tuple[str, ...]:
    """Return the words before a daemon's command line that put a saboteur into it, listening at `orders`."""
    return sys.executable, "-m", PROGRAM, str(orders)


async def order(orders: Path, text: str) -> str:
    """Send an order to the saboteur, and wait until it is carried out; send nothing in a sham campaign.

    Args:
        orders: Unix socket of the saboteur.
        text: Order and its argument.

    Returns:
        Answer of the saboteur.

    Raises:
        TimeoutError: The order was not carried out within `ANSWERS_WITHIN`.
    """
    return "" if is_sham() else await asyncio.to_thread(_order, orders, text)


def _order(orders: Path, text: str) -> str:
    answer_to = orders.with_suffix(f".{threading.get_ident()}")
    answer_to.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.bind(str(answer_to))
        sender.settimeout(ANSWERS_WITHIN)
        sender.sendto(text.encode(), str(orders))
        return sender.recv(1024).decode()


def main(words: Sequence[str]) -> None:
    """Run the command line after the first word, and take orders at that socket."""
    orders, module = Path(words[0]), words.index("-m")
    loops: list[asyncio.AbstractEventLoop] = []
    make = uvloop.new_event_loop

    def new_event_loop() -> uvloop.Loop:
        loop = make()
        loops.append(loop)
        return loop

    uvloop.new_event_loop = new_event_loop
    threading.Thread(target=_serve_orders, args=(orders, loops), daemon=True).start()
    sys.argv = ["pcmrs", *words[module + 2 :]]
    runpy.run_module(words[module + 1], run_name="__main__", alter_sys=True)


def _serve_orders(orders: Path, loops: list[asyncio.AbstractEventLoop]) -> None:
    orders.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(orders))
        while True:
            text, sender = listener.recvfrom(1024)
            done: list[str] = []
            carried_out = threading.Event()
            loops[-1].call_soon_threadsafe(_carry_out, text.decode(), done, carried_out)
            carried_out.wait(ANSWERS_WITHIN)
            listener.sendto((done[0] if done else "not carried out").encode(), sender)


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


def _allocate(size: str) -> str:
    _allocated.append(b"\1" * int(size))
    return "eaten"


_allocated: list[bytes] = []


def _tasks(_: str) -> str:
    return str(len(asyncio.all_tasks()))


ORDERS: dict[str, Callable[[str], str]] = {"block": _block, "eat": _allocate, "fail": _fail, "tasks": _tasks}

if __name__ == "__main__":
    main(sys.argv[1:])
