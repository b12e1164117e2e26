"""Lines that change a running cell: faults, and acts of the person with the pointer."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import cast

from pcmrs.cli.printing import say
from pcmrs.errors import ConfigurationError, PcmrsError
from pcmrs.messages import LandmarkPrompt
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.cli.terminal import forward_lines
from pcmrs_sim.faults import inject, parse_fault
from pcmrs_sim.pointer import SimPointer

POINTER_WORDS = ("touch", "touch_surface", "release")
"""Words for the person with the pointer: ``touch 0`` for the first landmark, ``touch_surface``, ``release``."""

Schedule = list[tuple[float, str]]
"""Times from the start, s, each with the line that is due then."""


def check_line(line: str) -> None:
    """Check that a line names a fault, or begins with a word for the person with the pointer.

    Args:
        line: The line. It must hold at least one word.

    Raises:
        PcmrsError: It does neither.
    """
    if line.split()[0] not in POINTER_WORDS:
        parse_fault(line)


async def apply_line(cell: CellSimulation, line: str) -> None:
    """Inject a fault, or move the pointer, as a line says.

    Args:
        cell: The running cell.
        line: The line. It must hold at least one word.

    Raises:
        PcmrsError: The line is wrong, or the cell refuses.
    """
    word, *rest = line.split()
    if word in POINTER_WORDS:
        await _move_pointer(cell, word, rest)
    else:
        inject(cell, *parse_fault(line))


def read_schedule(file: Path) -> Schedule:
    """Read a schedule, in the order of time, from lines such as ``5.0 occlude coil``; ``#`` begins a comment.

    Args:
        file: File in UTF-8. Times are in s from the start.

    Raises:
        ConfigurationError: A line is wrong; the error names its number.
    """
    schedule = []
    for number, text in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        if line := text.partition("#")[0].strip():
            try:
                time, _, action = line.partition(" ")
                check_line(action)
                schedule.append((_parse_seconds(time), action))
            except (PcmrsError, ValueError, IndexError) as error:
                reason = error.text if isinstance(error, PcmrsError) else "write: seconds, then a fault"
                raise ConfigurationError(f"{file}, line {number}: {reason}", file=str(file), line=number) from None
    return sorted(schedule)


def _parse_seconds(word: str) -> float:
    seconds = float(word)
    if not 0.0 <= seconds < math.inf:
        raise ConfigurationError(f"the time is {word}; it must be 0 s or later from the start")
    return seconds


async def follow_schedule(cell: CellSimulation, schedule: Schedule) -> None:
    """Apply each line of a schedule when it is due, and print errors to standard error.

    Args:
        cell: The running cell, in whose time the schedule runs.
        schedule: Lines in the order of time.
    """
    start = cell.clock.monotonic()
    for time, line in schedule:
        await cell.clock.sleep(start + time - cell.clock.monotonic())
        await _try_line(cell, line)


async def follow_input(cell: CellSimulation) -> None:
    """Apply the lines of standard input, one after the other, until cancelled."""
    lines: asyncio.Queue[str] = asyncio.Queue()
    forward_lines(lines.put_nowait)
    while True:
        await _try_line(cell, await lines.get())


async def _try_line(cell: CellSimulation, line: str) -> None:
    """Apply a line, and print an error to standard error."""
    try:
        await apply_line(cell, line)
    except PcmrsError as error:
        say(error.text, err=True)


async def _move_pointer(cell: CellSimulation, word: str, rest: list[str]) -> None:
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
