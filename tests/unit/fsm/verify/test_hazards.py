"""Hazards to the patient: irreversible operations that can be repeated, and missing ways back."""

from __future__ import annotations

from tests.unit.fsm.needle_workflow import PLAIN, found


def test_irreversible_operation_needs_one_that_allows_it_again() -> None:
    unmarked = PLAIN.replace('allows_again = ["sample"]', "title = 'again'")
    around = ("needle.insert", "needle.sample", "needle.withdraw", "needle.again", "needle.insert")
    assert found(unmarked) == [("repeatable", around)]
    assert found(PLAIN) == []


def test_a_sampled_needle_needs_a_way_back_to_the_start() -> None:
    no_return = "\n".join(line for line in PLAIN.splitlines() if not line.startswith("again ="))
    assert found(no_return) == [("no_way_back", ("needle.insert", "needle.sample"))]


def test_a_device_event_is_no_way_back() -> None:
    """Nobody can ask for it when the patient must be left."""
    by_device = PLAIN.replace('sampled = "done" } }', 'sampled = "done" }, event = true }')
    assert ("no_way_back", ("needle.insert",)) in found(by_device)
