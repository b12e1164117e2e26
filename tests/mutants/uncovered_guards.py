"""Guards that no test of the map makes hold something back, or lets anything pass."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import msgspec

from tests import ROOT
from tests.mutants.coverage_map import CoverageMap
from tests.mutants.generated_mutants import Guard

_EXCUSED = Path(__file__).with_name("uncovered.toml")


class Uncovered(msgspec.Struct, frozen=True, kw_only=True):
    """A guard of which one side was never run.

    Attributes:
        side: ``never holds`` if its body was never run; ``always holds`` if nothing ever passed it.
        reason: The reason why no test can or need run it; empty if there is none.
    """

    module: str
    function: str
    guard: str
    side: Literal["never holds", "always holds"]
    reason: str = ""


class Excuse(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A guard that no test need run.

    Attributes:
        guard: Its condition, exactly.
    """

    module: str
    function: str
    guard: str
    reason: str


def excuses() -> list[Excuse]:
    """Read the guards that no test need run."""
    return msgspec.convert(tomllib.loads(_EXCUSED.read_text())["uncovered"], list[Excuse])


def uncovered(guards: Sequence[Guard], coverage: CoverageMap, excused: Sequence[Excuse]) -> list[Uncovered]:
    """Find the guards of which one side was never run, in a test or in a process that one started.

    Raises:
        MapError: The map is of another source.
    """
    reasons = {(each.module, each.function, each.guard): each.reason for each in excused}
    found: list[Uncovered] = []
    for guard in guards:
        coverage.check(ROOT, guard.place.file)
        side = _side(guard, coverage)
        if side is not None:
            key = guard.module, guard.function, guard.place.text
            found.append(
                Uncovered(module=key[0], function=key[1], guard=key[2], side=side, reason=reasons.get(key, ""))
            )
    return found


def _side(guard: Guard, coverage: CoverageMap) -> Literal["never holds", "always holds"] | None:
    mapped = coverage.files[str(guard.place.file)]
    if not mapped.lines.keys() & set(guard.body):
        return "never holds"
    source = (ROOT / guard.place.file).read_text()
    first = source.count("\n", 0, guard.place.start) + 1
    condition = range(first, first + guard.place.text.count("\n") + 1)
    if not any(begin in condition and end not in condition and end not in guard.body for begin, end in mapped.arcs):
        return "always holds"
    return None
