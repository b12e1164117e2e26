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
    """The commit that is checked out; what nightly runs themselves publish is no change of it."""
    told = [":!tests/nightly/last.json", ":!tests/nightly/in_a_row.json", ":!docs/evidence.md"]
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", *told)
    return _git("rev-parse", "HEAD") + ("+" if changed else "")


def result_of(part: Part) -> Result | None:
    """The part's last result in this checkout."""
    path = FOLDER / f"{part.name}.json"
    return msgspec.json.decode(path.read_bytes(), type=Result) if path.exists() else None


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
        found = result_of(part)
        if found is not None:
            known[part.name] = found
    path.write_bytes(_lines([known[part.name] for part in parts() if part.name in known]))


def _lines(value: object) -> bytes:
    return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
