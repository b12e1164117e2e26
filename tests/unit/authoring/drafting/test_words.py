"""Findings in words: the step or requirement that each is about, and the commands that show it."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.authoring.design.tables import StepTable
from pcmrs.authoring.drafting._words import in_words
from pcmrs.fsm.finding import Finding
from tests.unit.authoring.drafting.made_answers import right

TABLE = msgspec.convert({**right(), "version": "1"}, StepTable)


@pytest.mark.parametrize(
    ("path", "place"),
    [
        (("steps", "1", "depends_on", "0"), "step aligned: "),
        (("requirements", "0"), "requirement ready: "),
        (("steps",), ""),
        ((), ""),
    ],
)
def test_a_path_becomes_a_name(path: tuple[str, ...], place: str) -> None:
    finding = Finding(code="step_unknown", text="No.", path=path)
    assert in_words(finding, TABLE) == f"{place}step_unknown: No."
    assert in_words(finding, None) == "step_unknown: No."


def test_commands_are_numbered() -> None:
    finding = Finding(code="deadlock", text="No.", commands=("a.b", "a.c:failed"))
    assert in_words(finding, None).endswith("show it: 1. a.b, 2. a.c:failed.")
