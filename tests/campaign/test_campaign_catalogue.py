"""The catalogue is whole, and what of it needs no access control is injected."""

from __future__ import annotations

import pytest

from pcmrs.campaign.catalogue import CLASSES, RESPONSES, catalogue, choose
from pcmrs.campaign.fault import fault, injections
from pcmrs.errors import ConfigurationError

COUNTS = {"O": 13, "S": 14, "B": 14, "N": 14, "P": 13, "T": 12, "C": 6, "A": 18}
LETTERS = dict(zip(COUNTS, CLASSES, strict=True))
WRONG_IN_THE_REFERENCE = {
    *("O2", "O4", "O6", "O7", "O11"),
    *("B1", "B2", "B3", "B10", "B11"),
    *("N5", "N7", "N14", "T10", "C1"),
    *("A5", "A6", "A8"),
}
ACCESS_CONTROL = {"O9", "C6", "A1", "A2", "A3", "A9", "A11", "A12", "A13", "A14", "A15", "A17", "A18"}


def test_every_row_is_there_once_and_in_its_class() -> None:
    expected = [f"{letter}{number + 1}" for letter, count in COUNTS.items() for number in range(count)]
    assert list(catalogue()) == expected
    assert len(expected) == 104
    for row in catalogue().values():
        assert row.fault_class == LETTERS[row.id[0]]
        assert row.title
        assert row.required


def test_what_the_reference_implementation_gets_wrong_is_said_and_nothing_else() -> None:
    assert {row.id for row in catalogue().values() if row.reference} == WRONG_IN_THE_REFERENCE


def test_what_needs_access_control_is_marked_and_not_injected() -> None:
    marked = [row.id for row in catalogue().values() if row.access_control]
    assert set(marked) == ACCESS_CONTROL
    assert not injections().keys() & set(marked)


@pytest.mark.parametrize("fault_class", ["operator", "sensor", "robot"])
def test_every_other_row_of_a_class_is_injected(fault_class: str) -> None:
    rows = [row for row in choose([fault_class]) if not row.access_control]
    assert not {row.id for row in rows} - injections().keys()
    for row in rows:
        ways = [way.how for way in injections()[row.id]]
        assert all(ways)
        assert len(set(ways)) == len(ways)


def test_letters_of_responses_are_explained() -> None:
    used = {word.strip(",:") for row in catalogue().values() for word in row.required.split()}
    assert {word for word in used if len(word) == 1 and word.isupper()} == set(RESPONSES)


def test_rows_are_chosen_by_class_and_id() -> None:
    assert choose() == list(catalogue().values())
    assert [row.id for row in choose(["clock"], ["S3"])] == ["S3", "C1", "C2", "C3", "C4", "C5", "C6"]


@pytest.mark.parametrize(("classes", "ids", "word"), [(["weather"], [], "weather"), ([], ["Z9", "S3"], "Z9")])
def test_what_the_catalogue_does_not_have_is_named(classes: list[str], ids: list[str], word: str) -> None:
    with pytest.raises(ConfigurationError, match=word):
        choose(classes, ids)


def test_nothing_is_registered_for_a_fault_that_does_not_exist() -> None:
    with pytest.raises(ConfigurationError, match="Z9"):
        fault("Z9", how="by magic")
