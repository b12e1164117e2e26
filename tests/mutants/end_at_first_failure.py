"""Plugin of pytest: the first failure of a test ends it, before anything is closed.

What lacks a guard may wait for ever when it is closed, and after a failure no limit of time holds any more. Hypothesis
tries the same examples as in the suite and does not look for the smallest one that fails.
"""

from __future__ import annotations

import os
import sys

import pytest
from hypothesis import Phase, settings


def pytest_configure() -> None:
    """Leave out the search for smaller examples."""
    settings.register_profile("unshrunk", settings(), phases=(Phase.explicit, Phase.generate, Phase.target))
    settings.load_profile("unshrunk")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Name the test and end; what a fixture cannot set up or clean up is no failure of a test."""
    if report.failed and report.when == "call":
        sys.stdout.write(f"\nFAILED {report.nodeid}\n")
        sys.stdout.flush()
        os._exit(pytest.ExitCode.TESTS_FAILED)
