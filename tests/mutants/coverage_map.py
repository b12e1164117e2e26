"""Which test reaches which line of the product: measured once, read whenever tests for a mutant are chosen.

The suite runs under coverage.py with one context for each test. Processes that a test starts are measured too, with the
test's id as their context; what they run is lost when they are killed. Python code that Zenoh calls in threads of its
own is not traced. coverage.py's own data have a row for every branch and test, so they are reduced to one set of tests
for each line.
"""

from __future__ import annotations

import hashlib
import os
import re
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
from coverage import CoverageData
from coverage.exceptions import CoverageException

from tests import ROOT
from tests.mutants.measured_tests import CONFIGURATION, RESULTS, Result

MAP = ROOT / "build" / "mutants" / "map.json"
MEASURED_TIME = 300
"""Limit of a test that is measured, s: tracing makes it slower."""

_COMMAND = "python -m tests.mutants.run_mutants map"
_PHASE = re.compile(r" \((?:setup|call|teardown)\)$")
_CONFIGURATION = """
[run]
branch = true
parallel = true
core = ctrace
sigterm = true
patch = _exit
context = ${{PYTEST_CURRENT_TEST-}}
data_file = {data}
source =
    {tree}/pcmrs
    {tree}/sim
    {tree}/lab
"""


class MapError(Exception):
    """There is no map, or it does not fit the sources."""


class MappedTest(msgspec.Struct, frozen=True):
    """A test that passed.

    Attributes:
        id: Node id of pytest.
        seconds: Duration under coverage.
    """

    id: str
    seconds: float


class MappedFile(msgspec.Struct):
    """What was run of a file.

    Attributes:
        digest: SHA-256 of its source.
        lines: Line number to the set of tests that ran it: bit *i* of the hexadecimal number is test *i*.
        arcs: Pairs of lines that were run one after the other; a negative number leaves or enters a function.
    """

    digest: str
    lines: dict[int, str]
    arcs: set[tuple[int, int]]


class CoverageMap(msgspec.Struct):
    """Tests and the lines that they run.

    Attributes:
        tests: Those that passed; only these can notice a mutant.
        failed: Ids of those that failed.
        files: By their path below the tree.
        lost: Data files of processes that ended while they wrote them.
    """

    tests: list[MappedTest]
    failed: list[str]
    files: dict[str, MappedFile]
    lost: int

    def reaching(self, file: Path, lines: Iterable[int]) -> list[MappedTest]:
        """Return the tests that run one of these lines."""
        mapped, found = self.files[str(file)].lines if str(file) in self.files else {}, 0
        for line in lines:
            found |= int(mapped.get(line, "0"), 16)
        return [test for number, test in enumerate(self.tests) if found >> number & 1]

    def updated(self, newer: CoverageMap, again: Sequence[str]) -> CoverageMap:
        """Return this map with the tests that a newer one has measured.

        Args:
            newer: Map of these tests only.
            again: Files or folders that it has measured; what it does not find in them any more is not kept.

        Raises:
            MapError: The newer one measured another state of a file.
        """
        inside = tuple(f"{each.rstrip('/')}{separator}" for each in again for separator in ("/", "::"))
        measured = {test.id for test in newer.tests} | set(newer.failed)
        measured |= {name for name in (*(test.id for test in self.tests), *self.failed) if name.startswith(inside)}
        kept = [test for test in self.tests if test.id not in measured]
        gone = [number for number, test in enumerate(self.tests) if test.id in measured][::-1]
        files = {}
        for name in sorted(self.files.keys() | newer.files.keys()):
            old, new = self.files.get(name), newer.files.get(name)
            known = [each for each in (old, new) if each is not None]
            if len({each.digest for each in known}) > 1:
                raise MapError(f"{name} has changed since all was measured. Measure all again: {_COMMAND}")
            lines = {line: _without(int(bits, 16), gone) for line, bits in (old.lines if old else {}).items()}
            for line, bits in (new.lines if new else {}).items():
                lines[line] = lines.get(line, 0) | int(bits, 16) << len(kept)
            arcs = set[tuple[int, int]]().union(*(each.arcs for each in known))
            files[name] = MappedFile(known[0].digest, {line: f"{each:x}" for line, each in lines.items()}, arcs)
        return CoverageMap(
            tests=kept + newer.tests,
            failed=[name for name in self.failed if name not in measured] + newer.failed,
            files=files,
            lost=self.lost + newer.lost,
        )

    def check(self, tree: Path, file: Path) -> None:
        """Compare a file with the one that was measured.

        Raises:
            MapError: It is another one.
        """
        mapped = self.files.get(str(file))
        if mapped is None or mapped.digest != _digest(tree / file):
            raise MapError(f"{file} is not the file that was measured. Measure again: {_COMMAND}")


def read_map(path: Path = MAP) -> CoverageMap:
    """Read a map.

    Raises:
        MapError: There is none.
    """
    if not path.is_file():
        raise MapError(f"{path} is missing. Make it (about half an hour): {_COMMAND}")
    return msgspec.json.decode(path.read_bytes(), type=CoverageMap)


def write_map(
    tests: Sequence[str], workers: int, path: Path = MAP, *, before: CoverageMap | None = None
) -> CoverageMap:
    """Run tests under coverage and write the map.

    Args:
        tests: Files or folders below the tree.
        workers: Number of processes; 0 for none beside pytest's own.
        path: Output file.
        before: Map that is updated with these tests.

    Raises:
        MapError: pytest did not run to its end, or `before` is of another state of the sources.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as name:
        folder = Path(name)
        results = folder / "results.json"
        configuration = folder / "coveragerc"
        configuration.write_text(_CONFIGURATION.format(data=folder / "data", tree=ROOT))
        # Whoever measures this process does not measure these ones: two tracers cannot share an interpreter.
        environment = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE_")}
        environment.pop("PYTEST_CURRENT_TEST", None)
        environment |= {
            "PYTHONPATH": f"{ROOT}:{ROOT}/sim:{ROOT}/lab",
            RESULTS: str(results),
            CONFIGURATION: str(configuration),
        }
        pytest = [
            "pytest",
            "-q",
            "-p",
            "tests.mutants.measured_tests",
            f"--timeout={MEASURED_TIME}",
            "--ignore=tests/mutants",
        ]
        command = [sys.executable, "-m", "coverage", "run", f"--rcfile={configuration}", "-m", *pytest]
        ended = subprocess.run(
            [*command, *(["-n", str(workers), "--dist", "worksteal"] if workers else ["-p", "no:xdist"]), *tests],
            cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        if ended.returncode not in (0, 1) or not results.is_file():
            raise MapError(f"pytest ended with {ended.returncode}:\n{ended.stdout[-4000:]}")
        found = _reduced(folder, msgspec.json.decode(results.read_bytes(), type=dict[str, Result]))
    found = found if before is None else before.updated(found, tests)
    path.write_bytes(msgspec.json.encode(found))
    return found


def _reduced(folder: Path, results: dict[str, Result]) -> CoverageMap:
    tests = [MappedTest(name, result.seconds) for name, result in sorted(results.items()) if result.passed]
    bits = {test.id: 1 << number for number, test in enumerate(tests)}
    lines: dict[str, dict[int, int]] = {}
    arcs: dict[str, set[tuple[int, int]]] = {}
    lost = 0
    for part in sorted(folder.glob("data.*")):
        try:
            data = CoverageData(basename=str(part))
            data.read()
            for measured in data.measured_files():
                file = str(Path(measured).relative_to(ROOT))
                known = lines.setdefault(file, {})
                for line, contexts in data.contexts_by_lineno(measured).items():
                    for context in contexts:
                        known[line] = known.get(line, 0) | bits.get(_PHASE.sub("", context), 0)
                arcs.setdefault(file, set()).update(data.arcs(measured) or ())
        except (CoverageException, sqlite3.Error):
            lost += 1
    return CoverageMap(
        tests=tests,
        failed=sorted(name for name, result in results.items() if result.failed),
        files={
            file: MappedFile(_digest(ROOT / file), {line: f"{each:x}" for line, each in known.items()}, arcs[file])
            for file, known in sorted(lines.items())
        },
        lost=lost,
    )


def _without(bits: int, numbers: Sequence[int]) -> int:
    """Return a set of tests without these, given in falling order; those behind them move up."""
    for number in numbers if bits else ():
        bits = bits >> number + 1 << number | bits & (1 << number) - 1
    return bits


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
