"""`pcmrs faults kill`: writers and daemons, and how many really died at a failpoint."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.failpoints import FAILPOINTS
from pcmrs_lab.campaign import daemonkills, kills
from pcmrs_lab.campaign.kills import RANDOM, KillReport


def report(what: str, **changed: Any) -> KillReport:
    given: dict[str, Any] = {"kills": 9, "acknowledged": 70, "lost": 0, "refused": [], "seed": 1, "seconds": 2.4}
    given |= {"at": {FAILPOINTS[0]: 4, FAILPOINTS[1]: 1, RANDOM: 2}, "not_reached": {FAILPOINTS[2]: 2}} | changed
    return KillReport(what, **given)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int, int, float | None]]:
    """What was killed, how many, with which seed, and for how long."""
    requests: list[tuple[str, int, int, float | None]] = []

    def writers(times: int, seed: int, _clock: Any, *, minutes: float | None, progress: Any) -> KillReport:
        requests.append(("writers", times, seed, minutes))
        return report("a writer", lost=int(seed == 66))

    async def daemons(times: int, seed: int, _clock: Any, *, minutes: float | None, progress: Any) -> KillReport:
        requests.append(("daemons", times, seed, minutes))
        return report("a daemon", refused=["It cannot be opened."] if seed == 67 else [])

    monkeypatch.setattr(kills, "kill_writers", writers)
    monkeypatch.setattr(daemonkills, "kill_daemons", daemons)
    return requests


def kill(*words: str) -> Result:
    return CliRunner().invoke(main, ["faults", "kill", *words])


def test_only_writers_are_killed_unless_daemons_are_asked_for(asked: list[Any]) -> None:
    assert kill().exit_code == 0
    assert asked == [("writers", 500, 1, None)]
    asked.clear()
    assert kill("--times", "0", "--daemons", "3", "--seed", "4", "--minutes", "0.5").exit_code == 0
    assert asked == [("daemons", 3, 4, 0.5)]


def test_deaths_at_random_instants_are_not_counted_at_failpoints(asked: list[Any]) -> None:
    line = next(line for line in kill("--daemons", "1").stdout.splitlines() if "a daemon" in line)
    assert line.split() == ["a", "daemon", "9", "5", "2", "70", "0", "0", "2"]


@pytest.mark.parametrize(("seed", "violated"), [("1", [False, False]), ("66", [True, False]), ("67", [False, True])])
def test_a_loss_or_an_unreadable_journal_is_a_violation(asked: list[Any], seed: str, violated: list[bool]) -> None:
    ended = kill("--daemons", "1", "--seed", seed, "--json")
    assert ended.exit_code == int(any(violated))
    assert [found["violated"] for found in json.loads(ended.stdout)["reports"]] == violated
