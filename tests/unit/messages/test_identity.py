"""Identities: names, validity, and the cells that two of them share."""

from __future__ import annotations

from math import inf
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import EVERY_CELL, LOCAL, Identity, check_cells, check_name, shared_cells

ANNA = Identity(name="anna", role="operator", serial="1", begins=10.0, ends=20.0, cells=EVERY_CELL)
ALL_CELLS = [f"{site}/{cell}" for site in "ab" for cell in "xy"]
patterns = st.lists(st.tuples(st.sampled_from("ab*"), st.sampled_from("xy*")).map("/".join), max_size=4)


@pytest.mark.parametrize(
    ("change", "now", "valid"),
    [
        ({}, 9.999, False),
        ({}, 10.0, True),
        ({}, 19.999, True),
        ({}, 20.0, False),
        ({"revoked": 15.0}, 12.0, False),
        ({"begins": 0.0, "ends": inf}, 1e12, True),
    ],
)
def test_an_identity_is_valid_in_its_time_unless_it_is_revoked(change: dict[str, Any], now: float, valid: bool) -> None:
    assert msgspec.structs.replace(ANNA, **change).valid(now) == valid


@pytest.mark.parametrize("name", ["a", "0", "anna-b.c_d", "a" * 63])
def test_a_name_that_is_a_chunk_of_keys_is_returned(name: str) -> None:
    assert check_name(name) == name


@pytest.mark.parametrize("name", ["", "Anna", "a/b", "*", ".a", "-a", "ä", "a b", "a\n", "a" * 64, LOCAL])
def test_a_name_that_could_mean_another_key_is_refused(name: str) -> None:
    with pytest.raises(ConfigurationError) as error:
        check_name(name)
    assert error.value.fields["name"] == name


def test_cells_are_a_site_and_a_name_or_a_star() -> None:
    assert check_cells(["lab/cell1", "lab/*", "*/*"]) == ("lab/cell1", "lab/*", "*/*")
    for cells in ([], ["lab"], ["lab/"], ["lab/cell1/x"], ["lab/c*"], ["lab/**"], ["lab/cell1", "Lab/cell1"]):
        with pytest.raises(ConfigurationError, match="is not a cell"):
            check_cells(cells)


@given(patterns, patterns)
def test_shared_cells_are_those_in_which_both_take_part(ones: list[str], others: list[str]) -> None:
    one, other, both = (
        msgspec.structs.replace(ANNA, cells=tuple(cells)) for cells in (ones, others, shared_cells(ones, others))
    )
    for cell in ALL_CELLS:
        assert both.in_cell(cell) == (one.in_cell(cell) and other.in_cell(cell))


@given(patterns)
def test_every_cell_shares_all_and_no_cell_none(cells: list[str]) -> None:
    assert shared_cells(cells, EVERY_CELL) == tuple(dict.fromkeys(cells)) == shared_cells(EVERY_CELL, cells)
    assert shared_cells(cells, ()) == ()
