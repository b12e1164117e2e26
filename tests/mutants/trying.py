"""Mutants are tried: each in a copy of the tree, so that processes which a test starts see it too.

Only a failure of a named test in its own code counts as caught, if the test passes on the product as it is. A test
that reaches the limit of time shows that something waits for ever, which may be the machine's fault: this is an outcome
of its own. Any other end of pytest (a crash, no tests, what cannot be collected, an error of a fixture) is
``broken`` and catches nothing.
"""

from __future__ import annotations

import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Literal

import msgspec
import pytest

from tests import ROOT
from tests.mutants.coverage_map import CoverageMap
from tests.mutants.places import Place
from tests.mutants.selecting_tests import Limits, select

TEST_TIME = 60
"""Limit of a test, s."""
COPIED = (
    "pcmrs",
    "sim",
    "lab",
    "tests",
    "clients",
    "examples",
    "benchmarks",
    "docs",
    "deploy",
    "fuzz",
    "pyproject.toml",
    "README.md",
)

Outcome = Literal["caught", "survived", "timed out", "broken", "not tested"]

_NOT_IMPORTED = re.compile(r"^ERROR (tests/\S+\.py)(?: - .*)?$", re.MULTILINE)
_FAILED = re.compile(r"^FAILED (tests/.*?)(?: - .*)?$", re.MULTILINE)
_TIMEOUT = "+++ Timeout +++"


class Candidate(msgspec.Struct, frozen=True, kw_only=True):
    """A mutant that can be tried.

    Attributes:
        name: Unique.
        where: Qualified name of its function.
        place: Text that it replaces.
        without: The text that takes its place.
        harm: The possible consequence; empty when it is not known.
    """

    name: str
    where: str
    place: Place
    without: str
    harm: str = ""


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a mutant.

    Attributes:
        outcome: ``not tested``: no test runs its lines.
        by: The test that failed, or the last text of pytest when it is broken.
        allowed: The reason why it need not be caught; empty when it must.
    """

    name: str
    where: str
    harm: str
    guard: str
    without: str
    outcome: Outcome
    by: str = ""
    tests: int = 0
    seconds: float = 0.0
    allowed: str = ""


class Allowed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A mutant that need not be caught.

    Attributes:
        name: Name of the mutant.
        outcome: The only outcome that is allowed.
        reason: Why no test can or need miss the guard.
    """

    name: str
    outcome: Literal["survived", "timed out", "not tested"]
    reason: str


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """Outcomes of all mutants.

    Attributes:
        share: Caught ones among those that must be caught.
        wanted: The least share.
        unfit: Tests that failed on a mutant, and fail on the product as it is as well.
    """

    mutants: list[Found]
    caught: int
    allowed: int
    share: float
    wanted: float
    unfit: list[str]

    @property
    def good(self) -> bool:
        """Whether enough were caught, by tests that pass otherwise."""
        return self.share >= self.wanted and not self.unfit


class Run(msgspec.Struct, frozen=True):
    """End of a run of pytest; the code is ``None`` when it had to be killed."""

    code: int | None
    failed: list[str]
    output: str


def try_mutants(
    candidates: Sequence[Candidate],
    coverage: CoverageMap,
    limits: Limits,
    wanted: float,
    *,
    allowed: Mapping[str, Allowed],
    jobs: int,
    show: Callable[[Found], None],
) -> Report:
    """Try each mutant in one of some copies of the tree.

    Args:
        candidates: The mutants.
        coverage: Map of the tests, of these sources.
        limits: Limits of the tests for each.
        wanted: The least share that must be caught.
        allowed: Mutants that need not be caught, by name.
        jobs: Number of copies.
        show: Called with each outcome.

    Raises:
        MapError: The map is of another source.
    """
    selected = {each.name: select(ROOT, each.place, coverage, limits) for each in candidates}
    copies: queue.Queue[Path] = queue.Queue()
    with ExitStack() as stack:
        for _ in range(jobs):
            copies.put(_copy_tree(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcmrs-mutants-")))))

        def attempt(candidate: Candidate) -> Found:
            copy = copies.get()
            try:
                found = _try(candidate, selected[candidate.name], copy, limits)
            finally:
                copies.put(copy)
            allowance = allowed.get(candidate.name)
            if allowance is not None and allowance.outcome == found.outcome:
                found = msgspec.structs.replace(found, allowed=allowance.reason)
            show(found)
            return found

        mutants = list(stack.enter_context(ThreadPoolExecutor(jobs)).map(attempt, candidates))
        unfit = _fail_as_it_is({each.by for each in mutants if each.outcome == "caught"}, copies.get())
    caught = sum(each.outcome == "caught" and each.by not in unfit for each in mutants)
    needless = sum(bool(each.allowed) for each in mutants)
    required = len(mutants) - needless
    return Report(
        mutants=mutants,
        caught=caught,
        allowed=needless,
        share=caught / required if required else 1.0,
        wanted=wanted,
        unfit=sorted(unfit),
    )


def _copy_tree(folder: Path) -> Path:
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, folder / name)
    return folder


def _try(candidate: Candidate, tests: Sequence[str], copy: Path, limits: Limits) -> Found:
    file, began = copy / candidate.place.file, time.monotonic()
    whole = file.read_text()
    file.write_text(candidate.place.replaced(copy, candidate.without))
    try:
        run = run_importable(tests, partial(_run_chosen, copy, limits)) if tests else None
    finally:
        file.write_text(whole)
        shutil.rmtree(copy / ".hypothesis", ignore_errors=True)  # examples that failed on this mutant
    outcome, by = outcome_of(run, tests)
    return Found(
        name=candidate.name,
        where=candidate.where,
        harm=candidate.harm,
        guard=candidate.place.text,
        without=candidate.without,
        outcome=outcome,
        by=by,
        tests=len(tests),
        seconds=time.monotonic() - began,
    )


def run_importable(tests: Sequence[str], run: Callable[[Sequence[str]], Run]) -> Run:
    """Run tests; where some files of them cannot be imported, run those in the others.

    pytest runs nothing when it cannot import one file, and nobody would see that tests in other files fail.

    Returns:
        The first run that has failed tests; else the first of all, since a file that cannot be imported is not passed.
    """
    first = last = run(tests)
    while not last.failed and last.code in (pytest.ExitCode.INTERRUPTED, pytest.ExitCode.USAGE_ERROR):
        broken = set(_NOT_IMPORTED.findall(last.output))
        others = [test for test in tests if test.partition("::")[0] not in broken]
        if not others or len(others) == len(tests):
            break
        tests, last = others, run(others)
    return last if last.failed else first


def outcome_of(run: Run | None, tests: Sequence[str]) -> tuple[Outcome, str]:
    """Return the outcome of a mutant, and the test that caught it or the last text of pytest.

    Args:
        run: End of its tests; None if no test runs its lines.
        tests: Ids of its tests.
    """
    if run is None:
        return "not tested", ""
    if run.code == 0:
        return "survived", ""
    if run.code == 1 and run.failed and run.failed[0] in tests:
        return "caught", run.failed[0]
    if run.code is None or (run.code == 1 and _TIMEOUT in run.output):
        return "timed out", ""
    return "broken", f"pytest ended with {run.code}: {run.output[-500:]}"


def _fail_as_it_is(tests: set[str], copy: Path) -> set[str]:
    """Run the tests that caught something on the product as it is, and return those that fail."""
    if not tests:
        return set()
    run = _run_tests(sorted(tests), copy, len(tests) * TEST_TIME)
    return set() if run.code == 0 else set(run.failed) or tests


def _run_chosen(copy: Path, limits: Limits, tests: Sequence[str]) -> Run:
    """Run tests of a mutant until one fails."""
    return _run_tests(tests, copy, limits.seconds + 2 * TEST_TIME, "-p", "tests.mutants.end_at_first_failure")


def _run_tests(tests: Sequence[str], copy: Path, seconds: float, *options: str) -> Run:
    """Run tests in a copy of the tree."""
    # The method `thread` ends pytest as a whole: a product that waits for ever may swallow exceptions, too.
    limits = (f"--timeout={TEST_TIME}", "--timeout-method=thread", "--hypothesis-seed=0")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", *limits, *options, *tests]
    # Compiled files make the next mutant of this copy quicker; what measures this process does not measure that one.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE_")}
    environment |= {"PYTHONPATH": f"{copy}:{copy}/sim:{copy}/lab", "PYTHONDONTWRITEBYTECODE": ""}
    with subprocess.Popen(
        command, cwd=copy, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        code: int | None
        try:
            output, _ = process.communicate(timeout=seconds)
            code = process.returncode
        except subprocess.TimeoutExpired:
            output, code = "", None
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # what a test that was broken off has left running
    return Run(code, _FAILED.findall(output), output)
