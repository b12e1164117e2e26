"""Runs the parts of a nightly run that have no green result for this code yet, one by one.

    make nightly                        # all that is left
    make nightly PART=faults            # faults-operator, faults-sensor, ...
    make nightly OPTIONS=--publish      # nothing is run: results of this checkout go to tests/nightly/last.json
    .venv/bin/python -m tests.nightly.run --names

Each part's result is in build/nightly/NAME.json, its output in NAME.log beside it. A run that is broken off goes on
with the part that it was at, on another machine, too, if its results were published and committed: a result counts for
every commit that differs from its own in `REPORTS` only. A part that makes a file for others is run where the file is
missing.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from datetime import UTC, datetime
from typing import IO

from tests import ROOT
from tests.nightly.nightly_counts import counted
from tests.nightly.nightly_parts import Part, chosen, command_of, separate
from tests.nightly.nightly_results import (
    FOLDER,
    Result,
    has_code_of,
    keep,
    publish,
    result_of,
    this_commit,
    this_machine,
)

OVERTIME = 3.0
"""A part that takes so many times what the table says, and hangs, is ended."""
GRACE = 30.0
"""Seconds in which it may end by itself."""


def run_part(part: Part, commit: str) -> Result:
    """Runs a part, and keeps its result."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    report, log = FOLDER / f"{part.name}.xml", FOLDER / f"{part.name}.log"
    report.unlink(missing_ok=True)
    begun, start = datetime.now(UTC).isoformat(timespec="seconds"), time.monotonic()
    command = command_of(part, report, seed=int(commit[:7], 16))
    printed = FOLDER / f"{part.name}.out"
    with log.open("w") as errors, printed.open("w") as output:
        errored = subprocess.STDOUT if part.counted == "pytest" else errors
        code = _end(command, 60 * OVERTIME * part.minutes, output, errored)
    found = counted(part.counted, report, printed.read_text(errors="replace"), code)
    result = Result(
        part=part.name,
        commit=commit,
        machine=this_machine(),
        begun=begun,
        seconds=round(time.monotonic() - start, 1),
        passed=found.passed,
        failed=found.failed,
        skipped=found.skipped,
        failures=found.failures,
        exit_code=code,
    )
    keep(result)
    return result


def _end(command: list[str], limit: float, output: IO[str], errors: IO[str] | int) -> int:
    """Exit code of a command; one that is too late, or broken off here, is ended with all that it has started."""
    with subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=errors, start_new_session=True) as process:
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            return 124
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)  # so that tests end their daemons
                with suppress(subprocess.TimeoutExpired):
                    process.wait(GRACE)
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)


def told(result: Result) -> str:
    """A line that says what became of a part."""
    counts = f"{result.passed} passed, {result.failed} failed, {sum(result.skipped.values())} skipped"
    return f"{'green' if result.green else 'RED  '} {result.part:<26} {counts}, {result.seconds:.0f} s"


def main() -> int:
    """0 when all that was chosen is green for this commit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="", metavar="PART", help="a part, or the first word of some")
    parser.add_argument(
        "--names", action="store_true", help="print what separate machines can run as JSON, and run nothing"
    )
    parser.add_argument(
        "--publish", action="store_true", help="gather results in tests/nightly/last.json, and run nothing"
    )
    options = parser.parse_args()
    found = chosen(options.part)
    if not found:
        parser.error(f"There is no part {options.part}: {', '.join(part.name for part in chosen(''))}.")
    if options.names:
        print(json.dumps(separate()))  # noqa: T201
        return 0
    if options.publish:
        publish()
        return 0
    commit, green = this_commit(), True
    for part in found:
        before = result_of(part)
        is_done = before is not None and before.green and part.is_made and has_code_of(commit, before.commit)
        result = before if before is not None and is_done else run_part(part, commit)
        sys.stdout.write(told(result) + ("  (before)" if is_done else "") + "\n")
        for each in result.failures:
            sys.stdout.write(f"        {each}\n")
        sys.stdout.flush()
        green = green and result.green
    return 0 if green else 1


if __name__ == "__main__":
    sys.exit(main())
