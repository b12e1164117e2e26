"""What is taken from an answer: sentences that are in the protocol, and no key that a model must not write."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

from pcmrs.authoring.drafting._answer import ExaminedAnswer, examine_answer
from pcmrs.fsm.blueprint import ProvenanceSpec
from tests.unit.authoring.drafting.made_answers import NEVER, PROTOCOL, RIGHT, changed

ORIGIN = ProvenanceSpec(model="made", prompt="ab", protocol="cd", date="2026-11-27")


def examined(answer: str, protocol: str = PROTOCOL) -> ExaminedAnswer:
    return examine_answer(answer, protocol, ORIGIN, complete=True)


def test_white_space_and_marks_of_a_sentence_do_not_matter() -> None:
    wrapped = PROTOCOL.replace("The robot aligns", "The **robot**\naligns")
    assert examined(RIGHT, wrapped).findings == []
    assert [finding.code for finding in examined(RIGHT, PROTOCOL.replace(NEVER, "")).findings] == ["draft_source"]


def test_the_version_of_a_draft_is_ours() -> None:
    table = tomllib.loads(examined(RIGHT).text)
    assert (table["version"], table["provenance"]["prompt"]) == ("0.1.0", "ab")


@pytest.mark.parametrize(
    ("place", "keys"),
    [
        (lambda answer: answer, {"version": "9"}),
        (lambda answer: answer, {"unresolved": []}),
        (lambda answer: answer["steps"][1], {"checks": ["always"]}),
        (lambda answer: answer["steps"][1], {"reopened_by": [{"operation": "withdraw", "steps": ["shell"]}]}),
        (lambda answer: answer["steps"][1], {"alternatives": [{"operation": "other", "payload": "x"}]}),
        (lambda answer: answer["steps"][0], {"refined_by": {"branch": "b", "steps": [{"timeout_s": 1}]}}),
        (lambda answer: answer["steps"][0], {"refined_by": {"branch": "b", "points": 3}}),
    ],
)
def test_keys_of_engineers_are_refused_at_any_depth(place: Any, keys: dict[str, Any]) -> None:
    found = examined(changed(lambda answer: place(answer).update(keys)))
    assert [finding.code for finding in found.findings] == ["draft_code"]
    assert (found.table, found.text, found.blueprint) == (None, "", "")


@pytest.mark.parametrize(
    "change",
    [
        {"steps": None},
        {"steps": [1]},
        {"steps": [{"reopened_by": 1, "alternatives": "x", "refined_by": []}]},
        {"requirements": {}},
        {"questions": [None]},
    ],
)
def test_any_form_of_json_ends_in_a_finding(change: dict[str, Any]) -> None:
    found = examined(changed(lambda answer: answer.update(change)))
    assert [finding.code for finding in found.findings] == ["draft_answer"]
