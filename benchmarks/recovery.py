"""Time that a killed daemon needs to start again, with a long journal and with an empty one.

Makes a journal of a number of rows as a daemon writes them, starts a daemon on it, kills it with SIGKILL, and measures
from the start of the next process until it answers a query of its state; the same with an empty journal, in turn. The
times that Python needs to import the daemon, to open the journal, to read it back and to look up a repeated command are
also measured separately. The arm and the tracker are simulated.

    .venv/bin/python benchmarks/recovery.py [--rows 100000] [--starts 5] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from pathlib import Path

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command, Verdict
from pcmrs.service.restart.recorder import SNAPSHOT_EVERY, JournalRecorder
from pcmrs.testing.daemon import free_port
from pcmrs.workflows.opening import open_workflow

IMPORTS = "import time; begin = time.perf_counter(); import pcmrs.service._daemon, pcmrs.cli.serve; "
IMPORTS += "print(time.perf_counter() - begin)"
LAST = "the last command"


async def fill(path: Path, rows: int) -> None:
    """Write a journal with the recorder of the daemon: intents and outcomes, and a snapshot every 1000 rows.

    The largest possible number of rows follows the last snapshot, so that a start has the most to read.

    Args:
        path: Database file of the journal.
        rows: Number of rows.
    """
    rows += SNAPSHOT_EVERY - 2 if rows else 0
    blueprint = open_workflow("ratms").blueprint
    tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
    journal = Journal.open(path, durable=False)
    recorder = JournalRecorder(journal, SystemClock(), uuid.uuid4().hex, tag)
    recorder.read_back(blueprint)
    states = {name: next(iter(branch.states)) for name, branch in blueprint.branches.items()}
    for number in range(rows // 2):
        name = LAST if number == rows // 2 - 1 else f"c{number}"
        command = Command(
            id=name,
            branch="placement",
            operation="nudge",
            source="udp:planner",
            arguments={"translation": [0, 0, 1e-3]},
        )
        verdict = Verdict(
            id=name, branch="placement", operation="nudge", decision="accepted", state="placed", sequence=number
        )
        await recorder.decision(command, verdict, states, {"nudge_translation": [0, 0, 1e-3]}, with_intent=True)
    await journal.close()


async def parts(path: Path, rows: int) -> dict[str, float]:
    """Return the times of the daemon's first steps with the journal, s.

    Args:
        path: Database file of the journal.
        rows: Number of rows; 0 for an empty journal.
    """
    blueprint = open_workflow("ratms").blueprint
    tag = BlueprintTag(id=blueprint.id, version=blueprint.version, hash=blueprint.hash)
    begin = time.perf_counter()
    journal = Journal.open(path)
    opened = time.perf_counter()
    recorder = JournalRecorder(journal, SystemClock(), uuid.uuid4().hex, tag)
    recorder.read_back(blueprint)
    read = time.perf_counter()
    found = recorder.recall("udp:planner", LAST if rows else "c")
    recalled = time.perf_counter()
    assert (found is not None) == bool(rows)
    await journal.close()
    return {"open": opened - begin, "read back": read - opened, "recall": recalled - read}


def imports() -> float:
    """Return the time that a Python process needs to import the daemon, s."""
    ran = subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True)
    return float(ran.stdout)


class Cell:
    """Cell whose daemon is started and killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._name = f"c{uuid.uuid4().hex[:8]}"
        self._endpoint = f"tcp/127.0.0.1:{free_port()}"

    async def start(self) -> float:
        """Start a daemon, wait until it answers, kill it, and return the time until the answer, s."""
        links = ("planner", "robot", "visualization")
        values = [
            "cell.site=bench",
            f"cell.name={self._name}",
            f"cell.endpoint={self._endpoint}",
            f"cell.folder={self.folder}",
            *(f"gateway.{link}={{port=0,reply_port={free_port()}}}" for link in links),
            "gateway.mixed_reality={}",
            "gateway.mep={port=0}",
            "gateway.tcp_port=0",
            "robot.deadman=0.5",  # starting processes may delay the others for a while
        ]
        words = [word for value in values for word in ("--set", value)]
        begin = time.perf_counter()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "pcmrs.cli", "serve", "--json", *words),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            assert process.stdout is not None
            await asyncio.wait_for(process.stdout.readline(), 120.0)
            async with Client.connect(self._endpoint, "bench", self._name) as client:
                await client.state()
            return time.perf_counter() - begin
        finally:
            process.kill()
            await process.wait()


async def measure(rows: int, starts: int, show_step: Callable[[str], None]) -> dict[str, dict[str, list[float]]]:
    """Return all durations, s, by journal and part.

    Args:
        rows: Number of rows of the long journal.
        starts: Number of starts with each journal.
        show_step: Called with the current step.
    """
    found: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        cells = {count: Cell(Path(folder) / str(count)) for count in (rows, 0)}
        for count, cell in cells.items():
            cell.folder.mkdir()
            show_step(f"making a journal of {count} rows")
            await fill(cell.folder / "ratms.sqlite", count)
        for turn in range(starts):
            for count, cell in cells.items():
                show_step(f"start {turn + 1} of {starts} on {count} rows")
                times = await parts(cell.folder / "ratms.sqlite", count) | {
                    "process start to answer": await cell.start()
                }
                for part, seconds in times.items():
                    found.setdefault(f"{count} rows", {}).setdefault(part, []).append(seconds)
            found.setdefault("any", {}).setdefault("imports", []).append(imports())
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = asyncio.run(measure(options.rows, options.starts, lambda text: print(text, file=sys.stderr)))
    if options.json:
        print(json.dumps(found))
        return
    print(f"{'journal':>14} {'part':<24} {'median ms':>10} {'max ms':>10}")
    for journal, by_part in found.items():
        for part, seconds in by_part.items():
            middle, most = statistics.median(seconds) * 1000, max(seconds) * 1000
            print(f"{journal:>14} {part:<24} {middle:10.1f} {most:10.1f}")


if __name__ == "__main__":
    main()
