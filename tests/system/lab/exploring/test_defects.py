"""Defects that the product once had: the script that was found for each shows it, and holds on the product as it is."""

from __future__ import annotations

import pytest

from pcmrs_lab.campaign.explore.script import read_script
from pcmrs_lab.campaign.explore.session import run_session
from tests.system.lab.exploring.defects import DEFECTS, FOLDER, Defect
from tests.system.lab.exploring.search_defects import MOST_ACTS

BY_NAME = pytest.mark.parametrize("defect", DEFECTS.values(), ids=DEFECTS)


def test_every_script_shows_a_defect() -> None:
    assert {path.stem for path in FOLDER.glob("*.json")} == DEFECTS.keys()


@BY_NAME
def test_the_script_of_a_defect_holds_on_the_product(defect: Defect) -> None:
    found = run_session(read_script(defect.script))
    assert (found.invariant, found.text) == ("", "")


@BY_NAME
def test_a_defect_that_is_put_back_is_seen(defect: Defect, monkeypatch: pytest.MonkeyPatch) -> None:
    script = read_script(defect.script)
    assert len(script.acts) <= MOST_ACTS
    defect.apply(monkeypatch)
    assert run_session(script).invariant in defect.found_by
