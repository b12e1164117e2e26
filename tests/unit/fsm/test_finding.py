"""Findings as people read them: one line each, whatever a file holds, with a hint at what was meant."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pcmrs.errors import BlueprintError
from pcmrs.fsm.finding import Finding, hint, refuse, summary


@pytest.mark.parametrize(
    ("given_place", "heading"),
    [
        ({}, "no_start: None is drawn."),
        ({"file": "a.toml"}, "a.toml: no_start: None is drawn."),
        ({"file": "a.toml", "line": 3, "column": 7}, "a.toml:3:7: no_start: None is drawn."),
    ],
)
def test_a_heading_has_the_parts_of_the_place_that_are_known(given_place: dict[str, str | int], heading: str) -> None:
    finding = Finding(code="no_start", text="None is drawn.", **given_place)  # type: ignore[arg-type]
    assert finding.heading == heading
    assert str(finding) == heading


@pytest.mark.parametrize(
    ("commands", "shown"),
    [((), " (after the start)"), (("a.go", "b.stop:failed"), " (after a.go, b.stop:failed)")],
)
def test_commands_that_show_a_finding_are_listed(commands: tuple[str, ...], shown: str) -> None:
    assert str(Finding(code="deadlock", text="Stuck.", commands=commands)) == f"deadlock: Stuck.{shown}"


@given(st.text())
@example("\ud800\x1b[31m\u202e\u2028")
def test_no_character_moves_the_cursor_or_forges_a_line(text: str) -> None:
    shown = summary([Finding(code="x", text=text), Finding(code="y", text=text)])
    assert len(shown.splitlines()) == 2
    assert all(map(str.isprintable, shown.split("\n")))


def test_a_close_word_is_proposed_and_otherwise_all_are_listed() -> None:
    assert hint("registerd", ["planned", "registered"]) == "did you mean 'registered'?"
    assert hint("robot", ["planned", "registered"]) == "choose from planned, registered."


def test_a_refusal_carries_its_one_finding() -> None:
    with pytest.raises(BlueprintError) as refused:
        refuse("a.toml", "too_deep", "Split it.", (4, 2), ("branches", "arm"))
    (finding,) = refused.value.fields["findings"]
    assert finding == Finding(
        code="too_deep", text="Split it.", path=("branches", "arm"), file="a.toml", line=4, column=2
    )
    assert refused.value.text == "a.toml:4:2: too_deep: Split it."
