"""Names of tests fit on one line of a report."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

LONGEST = 60
"""Characters that the name of a test may have, without its parameters."""


def too_long(names: Iterable[str]) -> set[str]:
    """Return the names that have more than ``LONGEST`` characters."""
    return {name for name in names if len(name) > LONGEST}


def test_names_of_tests_have_at_most_60_characters(collected: list[Any]) -> None:
    """The tests of all files that this run has collected; in `make test` all."""
    assert too_long(each.name for each in collected) == set()


def test_name_of_61_characters_is_too_long() -> None:
    longest = "test_".ljust(LONGEST, "x")

    assert too_long([longest, f"{longest}x"]) == {f"{longest}x"}
