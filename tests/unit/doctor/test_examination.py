"""The verdict of an examination is the worst of its findings, whatever their order."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.doctor import _examination as examination
from pcmrs.doctor._check_result import CheckResult, CheckVerdict, bad, good, warning
from pcmrs.doctor._examination import examine
from pcmrs.settings import Settings, read_settings

ORDER: tuple[CheckVerdict, ...] = ("good", "warning", "bad")
MADE = {"good": good("a", "1"), "warning": warning("b", "2", "Do it."), "bad": bad("c", "3", "Do it.")}


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return read_settings(None, [f"cell.folder={tmp_path}"])


def test_the_worst_finding_decides(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    for verdicts in itertools.chain.from_iterable(itertools.product(ORDER, repeat=count) for count in range(4)):
        findings = [MADE[each] for each in verdicts]
        monkeypatch.setattr(examination, "_findings", lambda _, found=findings: iter(found))
        found = examine(settings)
        assert found.verdict == max(verdicts, key=ORDER.index, default="good")
        assert found.findings == findings, "in the order of the checks"


def test_the_limits_of_free_space_are_those_of_the_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Megabytes in the settings, bytes in the check."""
    given: list[tuple[Path, float, float]] = []

    def free_space(folder: Path, warn: float, least: float) -> Iterator[CheckResult]:
        given.append((folder, warn, least))
        yield good("free space", "enough")

    monkeypatch.setattr(examination, "free_space", free_space)
    words = [f"cell.folder={tmp_path}", "journal.warn_free_mb=2000", "journal.least_free_mb=300"]
    found = examine(read_settings(None, words))
    assert given == [(tmp_path, 2e9, 3e8)]
    checks = [each.check for each in found.findings]
    assert checks.index("real-time policy") < checks.index("free space") < checks.index("certificates")
