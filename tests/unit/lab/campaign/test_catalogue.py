"""The catalogue of faults is whole: every row once, in its class, with its response, and chosen by class or id."""

from __future__ import annotations

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs_lab.campaign.catalogue import CLASSES, RESPONSES, catalogue, choose

COUNTS = {"O": 13, "S": 20, "B": 15, "N": 14, "P": 13, "T": 12, "C": 6, "A": 40, "Q": 29}
LETTERS = dict(zip(COUNTS, CLASSES, strict=True))
WRONG_IN_THE_REFERENCE = {
    *("O2", "O4", "O6", "O7", "O11"),
    *("B1", "B2", "B3", "B10", "B11"),
    *("N5", "N7", "N14", "T10", "C1"),
    *("A5", "A6", "A8"),
}


def test_every_row_is_there_once_and_in_its_class() -> None:
    expected = [f"{letter}{number + 1}" for letter, count in COUNTS.items() for number in range(count)]
    assert list(catalogue()) == expected
    assert len(expected) == 162
    for row in catalogue().values():
        assert row.fault_class == LETTERS[row.id[0]]
        assert row.title
        assert row.required


def test_only_faults_that_the_reference_gets_wrong_are_marked_so() -> None:
    assert {row.id for row in catalogue().values() if row.reference} == WRONG_IN_THE_REFERENCE


def test_letters_of_responses_are_explained() -> None:
    used = {word.strip(",:") for row in catalogue().values() for word in row.required.split()}
    assert {word for word in used if len(word) == 1 and word.isupper()} == set(RESPONSES)


def test_rows_are_chosen_by_class_and_id() -> None:
    assert choose() == list(catalogue().values())
    assert [row.id for row in choose(["clock"], ["S3"])] == ["S3", "C1", "C2", "C3", "C4", "C5", "C6"]


@pytest.mark.parametrize(("classes", "ids", "word"), [(["weather"], [], "weather"), ([], ["Z9", "S3"], "Z9")])
def test_unknown_class_or_fault_is_named(classes: list[str], ids: list[str], word: str) -> None:
    with pytest.raises(ConfigurationError, match=word):
        choose(classes, ids)
