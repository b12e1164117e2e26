"""Runs `make test` some times in a row and keeps what became of each run, for docs/evidence.md.

    python tests/nightly/in_a_row.py [RUNS] [--beside PROCESSES]

Ends with 1 at the first run that is not green. A run is kept in tests/nightly/in_a_row.json, whatever became of it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import msgspec
from nightly_counts import counted
from nightly_parts import ROOT
from nightly_results import Machine, this_commit, this_machine

LIST = Path(__file__).with_name("in_a_row.json")


class SuiteRun(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one run of the suite.

    Attributes:
        begun: ISO 8601, UTC.
        beside: Computing processes that ran beside it.
        failures: Names of what failed.
    """

    commit: str
    machine: Machine
    begun: str
    seconds: float
    beside: int
    passed: int
    failed: int
    skipped: int
    failures: list[str]
    exit_code: int


def kept() -> list[SuiteRun]:
    """All runs that were kept, the oldest first."""
    return msgspec.json.decode(LIST.read_bytes(), type=list[SuiteRun])


def run_suite(beside: int) -> SuiteRun:
    """Runs the suite once."""
    begun, start = datetime.now(UTC).isoformat(timespec="seconds"), time.monotonic()
    with tempfile.TemporaryDirectory() as folder, computing(beside):
        report = Path(folder) / "report.xml"
        command = ["make", "test", f"OPTIONS=--tools-installed --junitxml={report}"]
        code = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False).returncode
        found = counted("pytest", report, "", code)
    return SuiteRun(
        commit=this_commit(),
        machine=this_machine(),
        begun=begun,
        seconds=round(time.monotonic() - start, 1),
        beside=beside,
        passed=found.passed,
        failed=found.failed,
        skipped=sum(found.skipped.values()),
        failures=found.failures,
        exit_code=code,
    )


@contextmanager
def computing(number: int) -> Iterator[None]:
    """So many processes that do nothing but compute, for as long as the context lasts."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(number)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def main() -> int:
    """0 when all were green."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--beside", type=int, default=0, metavar="PROCESSES", help="computing processes beside a run")
    options = parser.parse_args()
    for _ in range(options.runs):
        run = run_suite(options.beside)
        LIST.write_bytes(msgspec.json.format(msgspec.json.encode([*kept(), run]), indent=1) + b"\n")
        sys.stdout.write(f"{run.passed} passed, {run.failed} failed, {run.skipped} skipped, {run.seconds:.0f} s\n")
        sys.stdout.flush()
        if run.exit_code:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
