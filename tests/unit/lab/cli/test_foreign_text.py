"""Commands of laboratory and simulator print text of other people without any effect on the terminal."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import example, given

from pcmrs.cli.tables import print_table
from pcmrs_lab.cli.faults import run as campaign
from pcmrs_sim.cli import lines
from tests.support.hostile_text import FORGING, HOSTILE, check_no_effect


@pytest.fixture(scope="module", autouse=True)
def wide() -> Iterator[None]:
    """A terminal on which no line is wrapped, so that each line that begins is one that was printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "3000")
        yield


def campaign_report(text: str) -> Any:
    fault = SimpleNamespace(id="A1", title=text, seed=1, outcome="failed", seconds=1.0, response=text, reference=text)
    return SimpleNamespace(sham=False, seeds=[1], seconds=1.0, faults=[fault], summary={})


def faults_run(text: str) -> None:
    print_table(campaign._tables(campaign_report(text)))


def typed_line(text: str) -> None:
    asyncio.run(lines._try_line(cast(Any, None), f"x{text}"))


@pytest.mark.parametrize(("work", "titled"), [(faults_run, True), (typed_line, False)])
@given(text=HOSTILE)
@example(text="[/x]")
@example(text=FORGING)
def test_foreign_text_has_no_effect_on_a_terminal(work: Callable[[str], None], titled: bool, text: str) -> None:
    check_no_effect(work, text, titled=titled)
