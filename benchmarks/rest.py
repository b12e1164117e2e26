"""Processor time and memory of a cell at rest, for each of its processes.

A daemon with default settings (simulated cell, recorder and console) is ready, and nobody uses it. Each process's share
of one processor comes from /proc/PID/stat, and its memory is the proportional set size (PSS) in /proc/PID/smaps_rollup
at the end: shared pages count in equal parts for the processes that share them. The console is started by the first
page; `--page` opens one without a browser and leaves it again. The aim is at most 10 % of one processor and 350 MB for
all processes together.

    .venv/bin/python benchmarks/rest.py [--seconds 30] [--settle 10] [--page] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import tempfile
import time
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

from pcmrs.testing.daemon import command_line, free_port, own_settings, running_daemon
from pcmrs.threads import descendants

TICKS = os.sysconf("SC_CLK_TCK")
"""Ticks of processor time per second."""
MOST_PERCENT, MOST_MB = 10.0, 350.0
"""Aims for all processes together: share of one processor, %, and PSS, MB."""


def name_of(pid: int) -> str:
    """Return a process's part in the cell, from its command line."""
    _python, _, module, *words = command_line(pid)
    return {"serve": "daemon"}.get(words[0], words[0]) if module == "pcmrs.cli" else module


def processor_time(pid: int) -> float:
    """Return the processor time that a process has used, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def proportional_size(pid: int) -> float:
    """Return the proportional set size of a process, MB."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    (size,) = (line.split()[1] for line in lines if line.startswith("Pss:"))
    return int(size) * 1024 / 1e6


def open_page(address: str) -> None:
    """Open the page without its token, which starts the process that serves it."""
    host, port = address.removeprefix("http://").split(":")
    connection = HTTPConnection(host, int(port), timeout=120.0)
    connection.request("GET", "/")
    status = connection.getresponse().status
    assert status == 401, status
    connection.close()


async def measure(seconds: float, settle: float, *, page: bool) -> dict[str, Any]:
    """Run a cell, and return the shares and sizes of its processes.

    Args:
        seconds: Time over which processor time is measured, s.
        settle: Time before, in which the processes finish their starts, s.
        page: True to have the console started by a page.
    """
    with tempfile.TemporaryDirectory() as folder:
        own = own_settings(Path(folder) / "cell", "rest")
        settings = [each for each in own if not each.startswith(("recording.", "console."))]
        settings.append(f"console.port={free_port()}")
        async with running_daemon(settings, Path(folder) / "log") as daemon:
            if page:
                await asyncio.to_thread(open_page, daemon.ready.console)
            await asyncio.sleep(settle)
            pids = [daemon.process.pid, *descendants(daemon.process.pid)]
            before, begin = {pid: processor_time(pid) for pid in pids}, time.monotonic()
            await asyncio.sleep(seconds)
            used, passed = {pid: processor_time(pid) - before[pid] for pid in pids}, time.monotonic() - begin
            processes: list[dict[str, Any]] = [
                {"process": name_of(pid), "percent": 100.0 * used[pid] / passed, "pss_mb": proportional_size(pid)}
                for pid in pids
            ]
    total = {key: sum(each[key] for each in processes) for key in ("percent", "pss_mb")}
    return {"seconds": passed, "processes": processes, "total": total}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--settle", type=float, default=10.0)
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = asyncio.run(measure(options.seconds, options.settle, page=options.page))
    if options.json:
        print(json.dumps(found))
        return
    print(f"{'process':<38} {'% of a core':>12} {'PSS, MB':>9}")
    for each in (*found["processes"], {"process": "all", **found["total"]}):
        print(f"{each['process']:<38} {each['percent']:12.1f} {each['pss_mb']:9.0f}")
    print(f"{'aim, at most':<38} {MOST_PERCENT:12.1f} {MOST_MB:9.0f}")


if __name__ == "__main__":
    main()
