"""Shared parts of all readers of charts: each finding once, events of a label, and names that differ."""

from __future__ import annotations

import pytest

from pcmrs.authoring.exchange.importing._reading import Findings, Names, events_of, read_text


def test_a_finding_is_reported_once() -> None:
    findings = Findings("a.mmd")
    for line in (3, 3, 4):
        findings.add("not_supported", "A choice is not supported.", (line, 1))
    assert [(each.file, each.line) for each in findings] == [("a.mmd", 3), ("a.mmd", 4)]


def test_a_byte_order_mark_is_no_part_of_the_text() -> None:
    assert read_text("\ufeffstateDiagram".encode(), "a.mmd") == "stateDiagram"


@pytest.mark.parametrize(
    ("label", "events"),
    [
        ("open", ["open"]),
        ("open,  slam shut , open", ["open", "slam shut"]),
        ("push (gently), pull (hard)", ["push", "pull"]),
        ("push (not (too) hard)", ["push (not (too) hard)"]),
        ("", []),
        (" , ", []),
        ("go [if warm]", []),
        ("go / beep", []),
    ],
)
def test_a_label_names_events_without_conditions_and_actions(label: str, events: list[str]) -> None:
    assert events_of(label) == events


@pytest.mark.parametrize(
    ("raw", "name", "code"),
    [
        ("slamShut", "slam_shut", None),
        ("Slam-shut!", "slam_shut_", None),
        ("door.open", "open", None),
        ("door_IS_open", "open", None),
        ("1st", "1st", "bad_name"),
        ("", "", "bad_name"),
        ("x" * 65, "x" * 65, "bad_name"),
        ("class", "class", "reserved_name"),
        ("Failed", "failed", "reserved_name"),
        ("active", "active", "reserved_name"),
    ],
)
def test_a_name_has_the_letters_of_a_blueprint_or_is_refused(raw: str, name: str, code: str | None) -> None:
    findings = Findings("a.mmd")
    assert Names("operations of door", findings).make(raw, (2, 5), prefix="door") == name
    assert [(each.code, each.line, each.column) for each in findings] == ([(code, 2, 5)] if code else [])


def test_two_words_with_one_name_collide_at_the_second() -> None:
    findings = Findings("a.mmd")
    names = Names("states of door", findings, states=True)
    for line, raw in enumerate(["Wide open", "wide_open", "ajar"], 1):
        names.make(raw, (line, 1))
    assert [(each.code, each.line) for each in findings] == [("name_collision", 2)]
    assert "'wide_open' and 'Wide open' would both be 'wide_open'" in findings[0].text


def test_states_may_be_digits_and_words_of_python() -> None:
    findings = Findings("a.mmd")
    names = Names("states of door", findings, states=True)
    assert [names.make(raw, (1, 1)) for raw in ("1", "class", "failed")] == ["1", "class", "failed"]
    assert not findings
