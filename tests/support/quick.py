"""`--quick`: leaves out the tests that take long, as `tests/slow.txt` lists them; `make check` runs what is left.

`pytest --costs FILE` writes the processor time of each test; `python -m tests.support.quick FILE` makes the list of it.
"""

from __future__ import annotations

import os
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tests import TESTS

QUICK, COSTS = "--quick", "--costs"
LIST = TESTS / "slow.txt"
LONGEST = 0.1
"""Processor time above which a test is left out, s. A parametrized test is left out if one instance takes longer."""


def add_options(parser: pytest.Parser) -> None:
    """Adds the options of this module."""
    parser.addoption(QUICK, action="store_true", help="leave out the tests that tests/slow.txt lists")
    parser.addoption(COSTS, metavar="FILE", help="append the processor time of each test to a file")


def name_of(item: pytest.Item) -> str:
    """Returns file and function of a test, as the list has them."""
    return f"{item.path.relative_to(TESTS).as_posix()}::{item.name.partition('[')[0]}"


def leave_out_slow(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselects the tests of the list."""
    slow = set(LIST.read_text().split())
    left_out = [item for item in items if name_of(item) in slow]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if name_of(item) not in slow]


class Costs:
    """Appends a line with processor time, s, and name for each test; every process of xdist writes to the same file.

    Args:
        file: The file.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        before = _processor_time()
        done = yield
        with self._file.open("a") as out:
            out.write(f"{_processor_time() - before:.3f} {name_of(item)}\n")
        return done


def _processor_time() -> float:
    """Time of this process and of its ended children, s."""
    return sum(os.times()[:4])


def slow_tests(lines: Iterable[str]) -> list[str]:
    """Returns the tests of which an instance takes too long.

    Args:
        lines: Lines that `Costs` wrote, of one or more runs.
    """
    longest: dict[str, float] = defaultdict(float)
    for line in lines:
        cost, name = line.split()
        longest[name] = max(longest[name], float(cost))
    return sorted(name for name, cost in longest.items() if cost > LONGEST and name.startswith("unit/"))


if __name__ == "__main__":
    LIST.write_text("\n".join(slow_tests(Path(sys.argv[1]).read_text().splitlines())) + "\n")
