"""Runs `make test` some times in a row and keeps what became of each run, for docs/evidence.md.

    python -m tests.nightly.in_a_row [RUNS] [--beside PROCESSES]

Ends with 1 at the first run that is not green. A run is kept in tests/nightly/in_a_row.json, whatever became of it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec

from tests.nightly.nightly_parts import Part
from tests.nightly.nightly_results import FOLDER, Result, this_commit
from tests.nightly.run import run_part, told

LIST = Path(__file__).with_name("in_a_row.json")
SUITE = "make-test"
COMMAND = f"make test OPTIONS='--tools-installed --junitxml={FOLDER / SUITE}.xml'"


class SuiteRun(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one run of the suite.

    Attributes:
        beside: Computing processes that ran beside it.
    """

    result: Result
    beside: int


def kept() -> list[SuiteRun]:
    """All runs that were kept, the oldest first."""
    return msgspec.json.decode(LIST.read_bytes(), type=list[SuiteRun])


def run_suite(beside: int) -> SuiteRun:
    """Runs the suite once."""
    with computing(beside):
        result = run_part(Part(name=SUITE, command=COMMAND, counted="pytest", minutes=20), this_commit())
    return SuiteRun(result=result, beside=beside)


@contextmanager
def computing(number: int) -> Iterator[None]:
    """So many processes that do nothing but compute, for as long as the context lasts.

    Each in a session of its own: Linux may give all processes of a session one share of the processors.
    """
    words = [sys.executable, "-c", "while True: pass"]
    processes = [subprocess.Popen(words, start_new_session=True) for _ in range(number)]
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
        sys.stdout.write(told(run.result) + "\n")
        sys.stdout.flush()
        if not run.result.green:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
