"""Plugin of pytest: coverage is recorded for each test, and how long each took and how it ended is written down.

The controlling process of xdist writes the file, the workers record the coverage.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from coverage import Coverage

RESULTS = "PCMRS_MEASURED_TESTS"
"""Environment variable with the file that the results are written to."""
CONFIGURATION = "PCMRS_MEASURED_AS"
"""Environment variable with the configuration of coverage.py for processes that a test starts."""


class Result(msgspec.Struct):
    """Result of a test in all its phases."""

    seconds: float = 0.0
    failed: bool = False
    skipped: bool = False

    @property
    def passed(self) -> bool:
        """Whether it ran and did not fail."""
        return not (self.failed or self.skipped)


_results: dict[str, Result] = {}


def pytest_configure() -> None:
    """Measure processes that start from now on, workers of xdist included.

    Each reads the configuration by itself, since that names the test which is running: what coverage.py's own patch
    hands down was read before the first test.
    """
    os.environ["COVERAGE_PROCESS_START"] = os.environ[CONFIGURATION]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Switch the context of the coverage to this test, and back."""
    coverage = Coverage.current()
    if coverage is None:
        raise RuntimeError("This plugin needs a pytest that runs under coverage.")
    coverage.switch_context(item.nodeid)
    try:
        return (yield)
    finally:
        coverage.switch_context("")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note the outcome."""
    result = _results.setdefault(report.nodeid, Result())
    result.seconds += report.duration
    result.failed |= report.failed
    result.skipped |= report.skipped


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the file, in the controlling process."""
    if not hasattr(session.config, "workerinput"):
        Path(os.environ[RESULTS]).write_bytes(msgspec.json.encode(_results))
