"""Every guard that is listed is in the product once; without it the product is another one that can be compiled."""

from __future__ import annotations

import ast
from collections import Counter
from functools import lru_cache
from pathlib import Path

import pytest

from tests import ROOT
from tests.mutants.listed_guards import Mutant, listed
from tests.mutants.places import find
from tests.mutants.selecting_tests import changed

MUTANTS = listed()


def test_names_are_unique_and_every_mutant_names_its_harm() -> None:
    assert [name for name, often in Counter(mutant.name for mutant in MUTANTS).items() if often > 1] == []
    assert [mutant.name for mutant in MUTANTS if not mutant.harm] == []


@pytest.mark.parametrize("module", sorted({mutant.module for mutant in MUTANTS}))
def test_a_listed_guard_is_there_once_and_can_be_taken_out(module: str) -> None:
    whole = lru_cache(lambda file: ast.dump(ast.parse((ROOT / file).read_text())))
    for mutant in MUTANTS:
        if mutant.module == module:
            place = mutant.place(ROOT)
            altered = place.replaced(ROOT, mutant.without)
            compile(altered, str(place.file), "exec")
            assert ast.dump(ast.parse(altered)) != whole(place.file), mutant.name
            assert changed(ROOT, place).lines, f"{mutant.name}: no statement, so no test could be chosen"


def test_a_moved_function_is_found_and_a_missing_one_is_named(tmp_path: Path) -> None:
    moved = tmp_path / "pcmrs" / "there" / "gate.py"
    moved.parent.mkdir(parents=True)
    moved.write_text("class Gate:\n    def check(self):\n        if self.shut:\n            raise OSError\n")
    mutant = Mutant(
        name="open", module="here.gate", function="Gate.check", guard="if self.shut:", without="if False:", harm="Any."
    )

    assert mutant.place(tmp_path).file == Path("pcmrs/there/gate.py")
    with pytest.raises(
        ValueError, match=r"'if self.open:' must occur once in Gate.check of here.gate; it occurs 0 times: nowhere"
    ):
        find(tmp_path, "here.gate", "Gate.check", "if self.open:")
