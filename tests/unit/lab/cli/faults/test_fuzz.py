"""`pcmrs faults fuzz`: what the daemon must not do, and the exit status if it does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.campaign import fuzz as campaign
from pcmrs_lab.campaign.fuzz import GROWTH_MB, FuzzReport

WELL: dict[str, Any] = {
    "datagrams": 1000,
    "dropped": 3,
    "answers": 20,
    "rate": 4999.6,
    "crashed": False,
    "state_changed": False,
    "rows": 0,
    "growth_mb": 1.25,
    "seed": 1,
    "seconds": 0.2,
}


def fuzz(monkeypatch: pytest.MonkeyPatch, *words: str, **changed: Any) -> Result:
    async def run(datagrams: int, seed: int, folder: Path, _clock: Any, *, minutes: Any, progress: Any) -> FuzzReport:
        return FuzzReport(**(WELL | {"datagrams": datagrams, "seed": seed} | changed))

    monkeypatch.setattr(campaign, "fuzz", run)
    return CliRunner().invoke(main, ["faults", "fuzz", *words])


def test_numbers_of_a_daemon_that_held_are_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = fuzz(monkeypatch)
    assert ended.exit_code == 0, ended.stderr
    lines = [" ".join(line.split()) for line in ended.stdout.splitlines()]
    assert "sent, and dropped by the kernel 1000000 and 3" in lines
    assert "per second 5000" in lines
    assert "state changed, commands in the journal no, 0" in lines
    assert "growth 1.2 MB" in lines


@pytest.mark.parametrize(
    "changed",
    [{"crashed": True}, {"state_changed": True}, {"rows": 1}, {"growth_mb": GROWTH_MB}],
    ids=lambda each: next(iter(each)),
)
def test_a_daemon_that_crashed_changed_or_grew_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any]
) -> None:
    ended = fuzz(monkeypatch, "--datagrams", "50", "--seed", "9", "--json", **changed)
    assert ended.exit_code == 1
    (found,) = json.loads(ended.stdout)["reports"]
    assert (found["violated"], found["datagrams"], found["seed"]) == (True, 50, 9)


def test_no_datagrams_are_a_usage_error(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fuzz(monkeypatch, "--datagrams", "0").exit_code == 2
