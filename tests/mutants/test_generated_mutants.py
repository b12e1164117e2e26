"""Mutants made by rule: which there are, which are left out, and which guards no test runs."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path

from tests import ROOT
from tests.mutants.coverage_map import CoverageMap, MappedFile
from tests.mutants.generated_mutants import PACKAGES, generated, guards, sample
from tests.mutants.uncovered_guards import Excuse, Uncovered, excuses, uncovered

SOURCE = '''
LIMIT = 1 < 2

if TYPE_CHECKING:
    import that


class Gate:
    def pass_through(self, visitors, größe=0 < 1):
        """Only an open gate."""
        if self.shut and "ä" != visitors:
            raise ValueError(f"{1 < 2}" if 3 < 4 else "")
        while self.busy == 1:
            if len(visitors) > 3:
                break
            self.log.info("waits", some=self.a < self.b)
        if (
            self.level <= 0.5
        ):
            self.open = True

        def inner():
            return visitors is None

        return inner

    def __repr__(self):
        return "shut" if self.shut == 1 else "open"
'''


def test_every_guard_comparison_and_junction_has_its_mutants(tmp_path: Path) -> None:
    file = tmp_path / "pcmrs" / "gateway" / "gate.py"
    file.parent.mkdir(parents=True)
    file.write_text(SOURCE)

    found = {each.name.removeprefix("gateway.gate:Gate.pass_through"): each for each in generated(tmp_path)}

    assert {name: (each.place.text, each.without) for name, each in found.items()} == {
        ":guard:1": ('self.shut and "ä" != visitors', '(self.shut and "ä" != visitors) and False'),
        ":junction:1": ('self.shut and "ä" != visitors', "(self.shut or 'ä' != visitors)"),
        ":comparison:1": ('"ä" != visitors', "(not ('ä' != visitors))"),
        ":guard:2": ("len(visitors) > 3", "(len(visitors) > 3) and False"),
        ":comparison:2": ("len(visitors) > 3", "(not (len(visitors) > 3))"),
        ":limit:1": ("len(visitors) > 3", "(len(visitors) >= 3)"),
        ":comparison:3": ("self.level <= 0.5", "(not (self.level <= 0.5))"),
        ".inner:comparison:1": ("visitors is None", "(not (visitors is None))"),
    }


def test_mutants_of_the_product_are_programs_in_every_package() -> None:
    mutants = generated()

    assert [name for name, often in Counter(each.name for each in mutants).items() if often > 1] == []
    assert {each.where.partition(".")[0] for each in mutants} == set(PACKAGES)
    drawn = sample(mutants, 200, 0)
    assert drawn == sample(mutants, 200, 0)
    for each in drawn:
        compile(each.place.replaced(ROOT, each.without), str(each.place.file), "exec")


def test_a_guard_is_uncovered_until_both_its_sides_are_run() -> None:
    guard = next(each for each in guards() if each.function == "NumberedSeries.add")
    line = guard.body.start
    digest = hashlib.sha256((ROOT / guard.place.file).read_bytes()).hexdigest()

    def side(*arcs: tuple[int, int], excused: tuple[Excuse, ...] = ()) -> list[Uncovered]:
        lines = {abs(number): "0" for arc in arcs for number in arc}
        mapped = MappedFile(digest, lines, set(arcs))
        coverage = CoverageMap(tests=[], failed=[], files={str(guard.place.file): mapped}, lost=0)
        return uncovered([guard], coverage, excused)

    passed, held = (line - 1, guard.body.stop), (line - 1, line)
    assert [each.side for each in side(passed)] == ["never holds"]
    assert [each.side for each in side(held)] == ["always holds"]
    assert side(passed, held) == []
    excuse = Excuse(guard.module, guard.function, guard.place.text, "Only with a broken clock.")
    assert [each.reason for each in side(held, excused=(excuse,))] == ["Only with a broken clock."]


def test_every_excused_guard_exists_and_has_a_reason() -> None:
    known = {(each.module, each.function, each.place.text) for each in guards()}
    assert [each for each in excuses() if (each.module, each.function, each.guard) not in known] == []
    assert [each for each in excuses() if not each.reason] == []
