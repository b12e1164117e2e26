"""Takes guards out of the product, one at a time, and counts how many of them the tests miss.

Every mutant runs in a copy of the tree, so that processes which a test starts see it too. The tests are run on the
product as it is, as well: what fails there would catch nothing. Tools that make mutants by rules of syntax would make
thousands, of which most are no guards; these here are written down, each with the harm that it could do.

    make mutants
    .venv/bin/python tests/mutants/run_removed_guards.py [NAME ...] [--jobs 2] [--json]
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Literal

import msgspec
from removed_guards import TREE, Mutant, declared
from rich.console import Console
from rich.table import Table

from pcmrs.cli.progress import progress_bar

WANTED = 0.95
"""So many of the mutants must be caught."""
TEST_TIME = 60
"""A test that takes longer has failed, s: without its guard the product may wait for ever."""
COPIED = ("pcmrs", "sim", "tests", "clients", "examples", "benchmarks", "docs", "deploy", "pyproject.toml", "README.md")

_OUTCOMES: dict[int, Literal["caught", "survived"]] = {0: "survived", 1: "caught"}
_FAILED = re.compile(r"^(?:FAILED|ERROR) (?:tests/)?(.*?)(?: - .*)?$", re.MULTILINE)


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a mutant.

    Attributes:
        outcome: ``broken``: pytest could not run its tests, or not to their end, which catches nothing.
        by: The test that failed.
    """

    name: str
    file: str
    harm: str
    outcome: Literal["caught", "survived", "broken"]
    by: str
    seconds: float


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What became of all of them.

    Attributes:
        unfit: Tests that fail on the product as it is, or why they could not be run.
    """

    mutants: list[Found]
    caught: int
    share: float
    unfit: list[str]

    @property
    def good(self) -> bool:
        """Whether enough were caught, by tests that pass otherwise."""
        return self.share >= WANTED and not self.unfit


def run_mutants(mutants: Sequence[Mutant], jobs: int, show: Callable[[Found], None]) -> Report:
    """Tries each mutant in one of `jobs` copies of the tree.

    Args:
        mutants: Which.
        jobs: How many at a time.
        show: Is told of each when it has been tried.
    """
    files = sorted({test for mutant in mutants for test in mutant.tests})
    copies: queue.Queue[Path] = queue.Queue()
    with ExitStack() as stack:
        for _ in range(jobs):
            copies.put(_copy_tree(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcmrs-mutants-")))))

        def attempt(mutant: Mutant) -> Found:
            copy = copies.get()
            try:
                found = _try(mutant, copy)
            finally:
                copies.put(copy)
            show(found)
            return found

        def attempt_whole() -> list[str]:
            copy = copies.get()
            try:
                return _fail_as_it_is(files, copy)
            finally:
                copies.put(copy)

        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        whole = pool.submit(attempt_whole)
        found = list(pool.map(attempt, mutants))
        unfit = whole.result()
    caught = sum(each.outcome == "caught" for each in found)
    return Report(mutants=found, caught=caught, share=caught / len(found), unfit=unfit)


def _copy_tree(folder: Path) -> Path:
    for name in COPIED:
        if (TREE / name).is_dir():
            shutil.copytree(TREE / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(TREE / name, folder / name)
    return folder


def _try(mutant: Mutant, copy: Path) -> Found:
    file, began = copy / "pcmrs" / mutant.file, time.monotonic()
    whole = file.read_text()
    file.write_text(mutant.altered(copy))
    try:
        code, failed = _run_tests(mutant.tests, copy, "-p", "end_at_first_failure")
    finally:
        file.write_text(whole)
    return Found(
        name=mutant.name,
        file=mutant.file,
        harm=mutant.harm,
        outcome=_OUTCOMES.get(code, "broken"),
        by=failed[0] if failed else "the limit of time" if code == 1 else "",
        seconds=time.monotonic() - began,
    )


def _fail_as_it_is(files: Sequence[str], copy: Path) -> list[str]:
    code, failed = _run_tests(files, copy)
    return failed or ([] if code == 0 else [f"pytest ended with {code}"])


def _run_tests(files: Sequence[str], copy: Path, *options: str) -> tuple[int, list[str]]:
    """Runs tests in a copy of the tree: pytest's exit code, and what failed."""
    # The method `thread` ends pytest as a whole: a product that waits for ever may swallow exceptions, too.
    limits = (f"--timeout={TEST_TIME}", "--timeout-method=thread", "--hypothesis-profile=mutants")
    command = [sys.executable, "-m", "pytest", "-q", *limits, *options, *(f"tests/{file}" for file in files)]
    # Compiled files make the next mutant of this copy quicker.
    environment = {**os.environ, "PYTHONPATH": f"{copy}:{copy}/tests/mutants", "PYTHONDONTWRITEBYTECODE": ""}
    with subprocess.Popen(
        command, cwd=copy, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    ) as tests:  # fmt: skip
        output, _ = tests.communicate()
    with suppress(ProcessLookupError):
        os.killpg(tests.pid, signal.SIGKILL)  # what a test that was broken off has left running
    return tests.returncode, _FAILED.findall(output)


def _table(report: Report) -> Table:
    table = Table(title=f"{report.caught} of {len(report.mutants)} removed guards are caught: {report.share:.1%}")
    for name in ("guard", "file", "outcome", "by, or what could go wrong"):
        table.add_column(name, overflow="fold")
    for each in sorted(report.mutants, key=lambda found: found.outcome):
        table.add_row(each.name, each.file, each.outcome, each.by if each.outcome == "caught" else each.harm)
    return table


def _chosen(names: Sequence[str]) -> list[Mutant]:
    known = {mutant.name: mutant for mutant in declared()}
    unknown = sorted(set(names) - known.keys())
    if unknown:
        sys.exit(f"There is no mutant {', '.join(unknown)}.")
    return [known[name] for name in names or known]


def main() -> int:
    """Prints the report; 0 when enough are caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="mutants to try; all when none is given")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="so many at a time")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    options = parser.parse_args()
    mutants, done = _chosen(options.names), 0
    with progress_bar() as bar:

        def show(found: Found) -> None:
            nonlocal done
            done += 1
            bar(f"{found.outcome} {found.name}", done, len(mutants))
            if not sys.stderr.isatty():
                sys.stderr.write(f"{done}/{len(mutants)} {found.outcome} {found.name} {found.by}\n")

        report = run_mutants(mutants, options.jobs, show)
    if options.json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        Console().print(_table(report), *(f"fails as it is: {test}" for test in report.unfit), sep="\n")
    return 0 if report.good else 1


if __name__ == "__main__":
    sys.exit(main())
