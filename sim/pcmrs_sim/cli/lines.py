"""Lines that change a running cell: faults, and what the person with the pointer does."""

from __future__ import annotations

import asyncio
import math
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import cast

import click

from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs.messages import LandmarkPrompt
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import inject, parse_fault
from pcmrs_sim.pointer import SimPointer

HAND = ("touch", "touch_surface", "release")
"""What the person can be told: ``touch 0`` for the first landmark, ``touch_surface``, ``release``."""

Schedule = list[tuple[float, str]]
"""Seconds from the start, and the line for then."""


def check_line(line: str) -> None:
    """Accepts a line that a cell could act on.

    Raises:
        PcmrsError: It is neither a fault nor anything for the person.
    """
    if line.split()[0] not in HAND:
        parse_fault(line)


async def act(cell: CellSimulation, line: str) -> None:
    """Acts on a line.

    Raises:
        PcmrsError: It cannot be done.
    """
    word, *rest = line.split()
    if word in HAND:
        await _move_hand(cell, word, rest)
    else:
        inject(cell, *parse_fault(line))


def read_schedule(file: Path) -> Schedule:
    """A schedule from a file with lines such as ``5.0 occlude coil``; ``#`` begins a comment.

    Raises:
        ConfigurationError: A line is none; its number is named.
    """
    found = []
    for number, text in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        if line := text.partition("#")[0].strip():
            try:
                time, _, action = line.partition(" ")
                check_line(action)
                found.append((_seconds(time), action))
            except (PcmrsError, ValueError, IndexError) as error:
                reason = error.text if isinstance(error, PcmrsError) else "write: seconds, then a fault"
                raise ConfigurationError(f"{file}, line {number}: {reason}", file=str(file), line=number) from None
    return sorted(found)


def _seconds(word: str) -> float:
    seconds = float(word)
    if not 0.0 <= seconds < math.inf:
        raise ConfigurationError(f"the time is {word}; it must be 0 s or later from the start")
    return seconds


async def follow_schedule(cell: CellSimulation, schedule: Schedule) -> None:
    """Acts on every line when its time has come."""
    start = cell.clock.monotonic()
    for time, line in schedule:
        await cell.clock.sleep(start + time - cell.clock.monotonic())
        await try_line(cell, line)


async def follow_input(cell: CellSimulation) -> None:
    """Acts on the lines of standard input, one after the other, until it ends."""
    lines: asyncio.Queue[str] = asyncio.Queue()
    loop = asyncio.get_running_loop()
    _read_in_thread(lambda line: loop.call_soon_threadsafe(lines.put_nowait, line))
    while True:
        await try_line(cell, await lines.get())


async def try_line(cell: CellSimulation, line: str) -> None:
    """Acts on a line; what cannot be done is said on standard error."""
    if not line.strip():
        return
    try:
        await act(cell, line)
    except PcmrsError as error:
        click.echo(error.text, err=True)


def _read_in_thread(take: Callable[[str], object]) -> None:
    """Standard input may be a terminal, a pipe or a file, and only a thread can wait for all of them."""

    def read() -> None:
        with suppress(RuntimeError, OSError):  # the loop has ended; the terminal listens to somebody else
            for line in sys.stdin:
                take(line)

    # In the background of a shell ("pcmrs-sim cell &") reading from the terminal would stop the whole process.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=read, name="standard input", daemon=True).start()


async def _move_hand(cell: CellSimulation, word: str, rest: list[str]) -> None:
    pointer = cast(SimPointer, cell.devices["pointer"])
    if word == "release":
        await pointer.release()
    elif word == "touch_surface":
        await pointer.touch_surface()
    else:
        landmarks = cell.world.phantom.landmarks
        if len(rest) != 1 or not rest[0].isdigit() or int(rest[0]) >= len(landmarks):
            raise ConfigurationError(f"Write touch and the number of a landmark, 0 to {len(landmarks) - 1}.")
        index = int(rest[0])
        x, y, z = landmarks[index].position.tolist()
        prompt = LandmarkPrompt(index=index, name=landmarks[index].name, position_in_image=(x, y, z))
        await pointer.touch(prompt)
