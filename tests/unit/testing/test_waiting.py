"""Waiting for a condition: it ends as soon as the condition is fulfilled, and with an error if it never is."""

from __future__ import annotations

import asyncio
import re
import sys
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.testing.errors import Unmet
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs.testing.waiting import PATIENCE, POLL_PERIOD, wait_until
from tests import ROOT

DOCS = ROOT / "docs"


async def waited(fulfilled_at: float, within: float) -> float:
    """Returns how long the wait was, s."""
    loop = asyncio.get_running_loop()
    await wait_until(lambda: loop.time() >= fulfilled_at, within)
    return loop.time()


@given(st.floats(0.0, 50.0))
def test_wait_ends_when_the_condition_is_fulfilled(seconds: float) -> None:
    assert 0.0 <= run_on_simulated_loop(waited(seconds, PATIENCE)) - seconds <= POLL_PERIOD + 1e-9


def test_condition_that_is_fulfilled_already_needs_no_time() -> None:
    assert run_on_simulated_loop(waited(0.0, 0.0)) == 0.0


def test_condition_that_is_never_fulfilled_is_unmet_in_time() -> None:
    async def course() -> float:
        with pytest.raises(Unmet, match=r"within 2\.5 s"):
            await waited(1e9, 2.5)
        return asyncio.get_running_loop().time()

    assert run_on_simulated_loop(course()) == pytest.approx(2.5, abs=POLL_PERIOD)


def test_any_true_value_fulfils_and_any_false_one_does_not() -> None:
    values = iter(([], "", 0, None, ["event"]))
    run_on_simulated_loop(wait_until(lambda: next(values)))
    assert next(values, None) is None


def test_an_error_of_the_condition_is_not_hidden() -> None:
    def fail() -> bool:
        raise TimeoutError("The device did not answer.")

    with pytest.raises(TimeoutError, match="did not answer"):
        run_on_simulated_loop(wait_until(fail))


def test_example_of_the_page_tests_the_driver_of_the_other_page(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = ModuleType("lab_tracker")
    monkeypatch.setitem(sys.modules, driver.__name__, driver)
    exec(code_of("new-device.md", "The driver", " lab_tracker.py"), driver.__dict__)
    found: dict[str, Any] = {}
    exec(code_of("testing.md", "A driver"), found)
    found["test_a_tracker_that_falls_silent_is_reported"]()


def code_of(page: str, heading: str, file: str = "") -> str:
    """Return the first block of Python code below a heading of a page."""
    text = (DOCS / page).read_text()
    block = re.search(rf"^## [\d. ]*{heading}.*?^```python{file}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert block is not None, f"{page} has no such code"
    return block[1]
