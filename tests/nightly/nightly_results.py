"""Results of parts: those of this checkout, below build/nightly, and those that are published in last.json."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

import msgspec

from tests import ROOT
from tests.nightly.nightly_parts import Part, parts

FOLDER = ROOT / "build" / "nightly"
PUBLISHED = Path(__file__).with_name("last.json")
REPORTS = (
    ":!docs/evidence.md",
    ":!docs/explore.md",
    ":!docs/progress.md",
    ":!CHANGELOG.md",
    ":!tests/nightly/last.json",
    ":!tests/nightly/in_a_row.json",
)
"""Files that report what was run: a result stays valid when they change."""


class Machine(msgspec.Struct, frozen=True, kw_only=True):
    """Where a part was run."""

    cores: int
    processor: str
    python: str
    kernel: str


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a part.

    Attributes:
        commit: That it was run on; ends with ``+`` where files were changed.
        begun: ISO 8601, UTC.
        skipped: Reason to how many.
        failures: Names of what failed.
    """

    part: str
    commit: str
    machine: Machine
    begun: str
    seconds: float
    passed: int
    failed: int
    skipped: dict[str, int]
    failures: list[str]
    exit_code: int

    @property
    def green(self) -> bool:
        """Whether all that was run passed, and something was."""
        return self.exit_code == 0 and not self.failed and self.passed > 0


def this_machine() -> Machine:
    """The machine that runs this."""
    facts = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.partition(":")[2].strip() for line in facts if line.startswith("model name")]
    return Machine(
        cores=len(os.sched_getaffinity(0)),
        processor=models[0] if models else platform.machine(),
        python=platform.python_version(),
        kernel=platform.release(),
    )


def this_commit() -> str:
    """The commit that is checked out, followed by ``+`` if files other than reports were changed since."""
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", *REPORTS)
    return _git("rev-parse", "HEAD") + ("+" if changed else "")


def has_code_of(commit: str, before: str) -> bool:
    """Whether two commits differ in nothing but reports; never if either had changed files, or is not known."""
    if "+" in commit + before:
        return False
    command = ["git", "diff", "--quiet", before, commit, "--", ".", *REPORTS]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0


def result_of(part: Part) -> Result | None:
    """The part's last result: the one of this checkout, or else the one that was published."""
    return _kept(part) or next((result for result in published(PUBLISHED) if result.part == part.name), None)


def keep(result: Result) -> None:
    """Writes a part's result, whole or not at all."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / f"{result.part}.json"
    beside = path.with_suffix(".json.new")
    beside.write_bytes(_lines(result))
    beside.replace(path)


def published(path: Path = PUBLISHED) -> list[Result]:
    """Results that were published, of whatever commits."""
    return msgspec.json.decode(path.read_bytes(), type=list[Result])


def publish(path: Path = PUBLISHED) -> None:
    """Replaces the published results of parts that have one in this checkout; those of parts that are gone go."""
    known = {result.part: result for result in published(path)}
    for part in parts():
        found = _kept(part)
        if found is not None:
            known[part.name] = found
    path.write_bytes(_lines([known[part.name] for part in parts() if part.name in known]))


def _kept(part: Part) -> Result | None:
    path = FOLDER / f"{part.name}.json"
    return msgspec.json.decode(path.read_bytes(), type=Result) if path.exists() else None


def _lines(value: object) -> bytes:
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
