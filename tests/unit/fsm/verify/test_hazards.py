"""Hazards to the patient: irreversible operations that can be repeated, and missing ways back."""

from __future__ import annotations

from tests.unit.fsm.needle_workflow import PLAIN, found


def test_irreversible_operation_needs_one_that_allows_it_again() -> None:
    unmarked = PLAIN.replace('allows_again = ["sample"]', "title = 'again'")
    around = ("needle.insert", "needle.sample", "needle.withdraw", "needle.again", "needle.insert")
    assert found(unmarked) == [("repeatable", around)]
    assert found(PLAIN) == []
