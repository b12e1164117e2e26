"""`--tools-installed`: on a machine with all of `make tools`, a skip that is not in skips.toml fails the run."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

BUDGET = Path(__file__).with_name("skips.toml")
OPTION = "--tools-installed"
_SENT = "skipped_modules"


def beyond_budget(skips: Iterable[tuple[str, str]], budget: Path = BUDGET) -> list[str]:
    """Skips that the budget does not have, as `name: reason`.

    Args:
        skips: Name and reason of each.
        budget: Table of the reasons that are allowed, and how often.
    """
    table = tomllib.loads(budget.read_text())["skip"]
    seen: Counter[str] = Counter()
    found = []
    for name, reason in skips:
        allowed = next((each for each in table if re.fullmatch(each["reason"], reason)), None)
        if allowed is not None:
            seen[allowed["reason"]] += 1
        if allowed is None or seen[allowed["reason"]] > allowed["most"]:
            found.append(f"{name}: {reason}")
    return found


class SkipBudget:
    """Counts the skips of a run, those of whole modules included, over all its processes."""

    def __init__(self, budget: Path = BUDGET) -> None:
        self._budget = budget
        self._skips: list[tuple[str, str]] = []
        self._of_modules: list[tuple[str, str]] = []

    def over(self) -> list[str]:
        """Skips that the budget does not have, each with its reason."""
        return beyond_budget([*self._skips, *self._of_modules], self._budget)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self._skips.append((report.nodeid, _reason(report)))

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.skipped:
            self._of_modules.append((report.nodeid, _reason(report)))

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Every process of xdist has collected everything: what one says of a module the others say, too."""
        for each in getattr(node, "workeroutput", {}).get(_SENT, []):
            if tuple(each) not in self._of_modules:
                self._of_modules.append(tuple(each))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        sent = getattr(session.config, "workeroutput", None)
        if sent is not None:
            sent[_SENT] = self._of_modules
        elif self.over() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        over = self.over()
        if over:
            terminalreporter.section(f"{len(over)} skips beyond tests/support/skips.toml", red=True, bold=True)
            for each in over:
                terminalreporter.line(each)


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return text.removeprefix("Skipped: ")
