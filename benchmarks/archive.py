"""Rate at which journals are archived, and the time of questions over all of them.

Writes the journals of a number of cells, adds each to an archive, and asks each of the shipped questions. Their rows
are made up: intents and outcomes of a daemon's size, with a configuration, a connection, placements and a Stop in each
session. Only the adding is timed, not the writing of the journals, which are deleted once they are archived. The
processor time is that of this process: beside other programs, it says more than the rate. With --archive and the
address of a PostgreSQL database, that is measured; it must not hold an archive.

    .venv/bin/python benchmarks/archive.py [--sessions 1000] [--rows 10000] [--cells 20] [--json]
    .venv/bin/python benchmarks/archive.py --archive postgresql://user@host/name --sessions 20 --cells 2
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from pcmrs.archive import QUESTIONS, ArchiveStore, add_journal, open_store, verify_archive
from pcmrs.journal import JournalRow
from pcmrs.journal.rows import encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.messages import BlueprintTag, Reason, Verdict

GROUP = 512
"""Rows of one commit of a journal."""
TOOLS = ("coil A", "coil B", "coil C")
STATES = {"alignment": "0", "digitization": "1", "placement": "placed", "registration": "111", "robot": "1"}
POSE = {"position": [0.1234, -0.2345, 0.3456], "quat_xyzw": [0.1, 0.2, 0.3, 0.927]}


def session(cell: int, number: int, rows: int) -> Iterator[JournalRow]:
    """Yield the rows of one session.

    Args:
        cell: Number of its cell.
        number: Number of the session.
        rows: Number of rows.
    """
    rng = random.Random(1000 * cell + number)
    wall = 1.7e9 + 86400.0 * number
    common: dict[str, Any] = {
        "boot_id": f"boot {cell}",
        "session_id": f"{rng.getrandbits(128):032x}",
        "blueprint": BlueprintTag(id="ratms", version="1.3.0", hash="12" * 32),
    }
    settings = {"cell": {"site": f"site{cell % 4}", "name": f"cell{cell}"}}
    row, count = dict[str, Any](kind="config", source="daemon", operation="started", result={"settings": settings}), 0
    for count in range(rows):
        yield JournalRow(wall=wall + 0.1 * count, monotonic=0.1 * count, **common, **row)
        row = _next(rng, row, count, rows, cell, number)


def _next(rng: random.Random, before: dict[str, Any], count: int, rows: int, cell: int, number: int) -> dict[str, Any]:
    """Return the fields of the row after one: an outcome after each intent, one Stop, and commands."""
    if before["kind"] == "intent":
        names = {name: before[name] for name in ("branch", "operation")}
        verdict = Verdict(
            id=before["command_id"], **names, state="placed", sequence=count, **_decision(rng, **names, cell=cell)
        )
        return {**before, "kind": "outcome", "verdict": verdict, "result": {"nudge_translation": [0.0, 0.0, 1e-3]}}
    if count == rows // 2:
        fields = {"source": "bus:anna", "stop": count}
        result = {"text": "Stopped by bus:anna.", "danger": True, "fields": fields}
        return {"kind": "device", "source": "bus:anna", "operation": "stopped", "states": STATES, "result": result}
    operation = "connect" if count < 2 else "confirm" if count % 100 == 0 else "nudge"
    return {
        "kind": "intent",
        "command_id": f"{number}-{count}",
        "source": "udp:planner:127.0.0.1",
        "user": "anna",
        "role": "operator",
        "branch": "robot" if operation == "connect" else "placement",
        "operation": operation,
        "arguments": {"translation": [0.0, 0.0, round(rng.random(), 6)]},
        "states": STATES,
    }


def _decision(rng: random.Random, branch: str, operation: str, cell: int) -> dict[str, Any]:
    if operation == "connect":
        return {"decision": "accepted", "result": {"calibration": {"tool": TOOLS[cell % 3], "pointer": "explicit"}}}
    if operation == "confirm":
        errors = {"translation_error": 1e-3 * rng.random(), "rotation_error": 0.01 * rng.random()}
        return {"decision": "accepted", "result": {"planned": POSE, "measured": POSE, **errors}}
    if rng.random() < 0.05:
        text = f"{branch}.{operation} cannot be reached."
        return {"decision": "rejected", "reason": Reason(code="unreachable", text=text)}
    return {"decision": "accepted", "result": {"duration": rng.random()}}


def write_journal(path: Path, cell: int, sessions: range, rows: int) -> None:
    """Write the journal of a cell.

    Args:
        path: Database file of the journal.
        cell: Number of the cell.
        sessions: Numbers of its sessions.
        rows: Number of rows of each.
    """
    writer = JournalWriter(path, durable=False)
    for number in sessions:
        found = session(cell, number, rows)
        while group := [(row, encode_row(row)) for row in islice(found, GROUP)]:
            writer.write(group)
            writer.maintain()
    writer.close()


def fill(store: ArchiveStore, cells: int, sessions: int, rows: int) -> dict[str, float]:
    """Archive the journals of all cells, and return the number of rows and the times, s.

    Args:
        store: The archive.
        cells: Number of cells.
        sessions: Number of sessions of all cells together.
        rows: Number of rows of each session.
    """
    found = {"rows": 0, "seconds": 0.0, "processor seconds": 0.0}
    for cell in range(cells):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "ratms.sqlite"
            write_journal(path, cell, range(cell * sessions // cells, (cell + 1) * sessions // cells), rows)
            begin, used = time.perf_counter(), time.process_time()
            found["rows"] += add_journal(store, path).added
            found["seconds"] += time.perf_counter() - begin
            found["processor seconds"] += time.process_time() - used
        print(f"{cell + 1} of {cells} cells, {found['rows']} rows", file=sys.stderr)
    return found


def ask(store: ArchiveStore) -> dict[str, dict[str, float]]:
    """Return number of rows and times of the answer to each question, s."""
    found = {}
    for name, question in QUESTIONS.items():
        begin, used = time.perf_counter(), time.process_time()
        with store.ask(question.sql) as answer:
            rows = answer.read_all().num_rows
        seconds, processor = time.perf_counter() - begin, time.process_time() - used
        found[name] = {"rows": rows, "seconds": seconds, "processor seconds": processor}
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=10_000, help="of each session")
    parser.add_argument("--cells", type=int, default=20)
    parser.add_argument("--archive", help="place of the archive; a temporary folder if not given")
    parser.add_argument("--verify", action="store_true", help="also verify the whole archive")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(options.archive or folder, make=True)
        found: dict[str, Any] = {"add": fill(store, options.cells, options.sessions, options.rows), "ask": ask(store)}
        if options.verify:
            begin = time.perf_counter()
            if not verify_archive(store).sound:
                raise SystemExit("The archive is damaged.")
            found["verify"] = {"seconds": time.perf_counter() - begin}
        store.close()
    if options.json:
        print(json.dumps(found))
        return
    added = found["add"]
    rows = added["rows"]
    rates = rows / added["seconds"], rows / added["processor seconds"]
    print(f"{rows:.0f} rows: {rates[0]:.0f} rows/s, {rates[1]:.0f} per processor second")
    for name, answer in found["ask"].items():
        times = f"{answer['seconds']:6.2f} s  {answer['processor seconds']:6.2f} s of the processors"
        print(f"  {name:<16}{times}  {answer['rows']} rows in the answer")
    if "verify" in found:
        print(f"  {'verify':<16}{found['verify']['seconds']:6.2f} s")


if __name__ == "__main__":
    main()
