"""Plugin of pytest: the first failure ends it, before anything is closed.

What lacks a guard may wait for ever when it is closed, and after a failure no limit of time holds any more.
"""

from __future__ import annotations

import os
import sys

import pytest


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Names the test and ends."""
    if report.failed:
        sys.stdout.write(f"\nFAILED {report.nodeid}\n")
        sys.stdout.flush()
        os._exit(pytest.ExitCode.TESTS_FAILED)
