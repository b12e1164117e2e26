"""The short programs of examples/clients, as whoever reads them runs them, one after the other on one cell."""

from __future__ import annotations

import asyncio
import csv
import os
import signal
import sys
from io import StringIO
from pathlib import Path

from pcmrs.testing.cell import LIGHT, RunningCell, open_cell
from tests import ROOT

EXAMPLES = ROOT / "examples" / "clients"


async def begin(cell: RunningCell, name: str, *words: str) -> asyncio.subprocess.Process:
    """A program that has begun; what it prints comes line by line."""
    address = {"PCMRS_ENDPOINT": cell.ready.endpoint, "PCMRS_CELL": cell.folder.name, "PYTHONUNBUFFERED": "1"}
    return await asyncio.create_subprocess_exec(
        sys.executable, str(EXAMPLES / name), *words,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, env={**os.environ, **address},
    )  # fmt: skip


async def end(process: asyncio.subprocess.Process) -> str:
    """What a program prints until its end; it fails the test if it fails."""
    said, complaint = await asyncio.wait_for(process.communicate(), 60.0)
    assert process.returncode == 0, complaint.decode()
    return said.decode()


async def line_of(process: asyncio.subprocess.Process) -> str:
    """The next line that a program prints."""
    assert process.stdout is not None
    line = await asyncio.wait_for(process.stdout.readline(), 60.0)
    assert line, "the program has ended"
    return line.decode().rstrip()


async def run(cell: RunningCell, name: str, *words: str) -> str:
    """What a whole program prints."""
    return await end(await begin(cell, name, *words))


async def test_each_program_does_what_it_says(tmp_path: Path) -> None:
    async with open_cell(tmp_path / "shown", LIGHT) as cell:
        placed = await run(cell, "place.py")
        assert placed.startswith("too early: ")
        assert "placement.home: accepted, placement is retracted" in placed
        assert "the landmarks fit within" in placed
        watching = await begin(cell, "watch.py")
        assert "placement=retracted" in await line_of(watching)  # it hears what is said from now on
        poses = asyncio.create_task(run(cell, "record_poses.py", "2"))
        stopped = await run(cell, "stop_in_motion.py")
        assert "approach: failed" in stopped
        assert "meanwhile: rejected, Stop is latched" in stopped
        assert "back_off: accepted" in stopped
        rows = list(csv.DictReader(StringIO(await poses)))
        assert {row["body"] for row in rows} >= {"coil", "body_ref"}
        for verdict in ("approach: failed", "approach: rejected", "back_off: accepted"):
            # A slow reader misses a state that lasts 0.1 s, but no verdict. Kept verdicts of place.py may come
            # first; one of them is a rejected approach, too.
            while await line_of(watching) != f"placement.{verdict}":
                pass
        watching.send_signal(signal.SIGINT)
        await asyncio.wait_for(watching.communicate(), 60.0)
        await run(cell, "watch.py", "1")  # ends by itself
        planned = await run(cell, "planner.py", str(cell.ready.links["planner"][1]))
        assert "session_reinitxx: 1_accepted_" in planned
        assert "execute_motionxx: 2_rejected_placement_retracted_" in planned
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "place.py", "planner.py", "record_poses.py", "stop_in_motion.py", "watch.py",
    }  # fmt: skip
