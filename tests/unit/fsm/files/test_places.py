"""Locations of keys in one file, and in a file that is merged into another."""

from __future__ import annotations

from pcmrs.fsm.files._keys import keys_in
from pcmrs.fsm.files.places import Places, with_locations
from pcmrs.fsm.finding import Finding


def places(text: str, origin: str = "own.toml") -> Places:
    return Places(text, keys_in(text), origin)


def test_tables_that_a_header_implies_have_its_place() -> None:
    found = places("\n[b.c]\nd = 2\n")
    assert found.of(("b",)) == found.of(("b", "c")) == ("own.toml", 2, 2)
    assert found.of(("b", "c", "d")) == ("own.toml", 3, 1)


def test_an_absent_key_has_the_place_of_the_nearest_one_above() -> None:
    found = places("x = 1\n[b]\nc = 1\n")
    assert found.of(("b", "gone", "deeper")) == ("own.toml", 2, 2)
    assert found.of(("gone",)) == ("own.toml", 1, 1)


def test_a_moved_element_hides_every_key_of_the_one_below() -> None:
    below = places('properties = [{ id = "p", text = "kept" },\n{ id = "q", text = "old" }]\n', "base.toml")
    own = places('\n\nproperties = [{ id = "q" }]\n')
    both = own.over(below, {("properties", "0"): ("properties", "1")})
    assert both.of(("properties", "0", "text")) == ("base.toml", 1, 27)
    assert both.of(("properties", "1", "id")) == ("own.toml", 3, 17)
    assert both.of(("properties", "1", "text")) == ("own.toml", 3, 15)
    assert below.of(("properties", "1", "text")) == ("base.toml", 2, 13)


def test_findings_get_file_line_and_column_of_their_path() -> None:
    found = with_locations(
        [Finding(code="bad_value", text="no", path=("b", "c")), Finding(code="no_start", text="none")],
        places("[b]\n  c = 1\n"),
    )
    assert [(each.code, each.file, each.line, each.column) for each in found] == [
        ("bad_value", "own.toml", 2, 3),
        ("no_start", "own.toml", 1, 1),
    ]
