"""`pcmrs faults explore`: how many sessions are run, what is printed of broken ones, and their scripts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.campaign.explore import exploring, session
from pcmrs_lab.campaign.explore.exploring import Broken, Explored
from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.script import Act, SessionScript, read_script, write_script
from pcmrs_lab.campaign.explore.session import ExplorationResult
from pcmrs_lab.scale.tasks import Workers

SCRIPT = SessionScript(7, acts=[Act(0.5, "stop", "ben"), Act(1.0, "fault:e_stop", "", {"on": True})])
BROKEN = Broken(7, "stop_holds", "The arm moves at [0.2] rad/s.", 3.25, 20, SCRIPT)


def explored(*broken: Broken) -> Explored:
    reached = dict.fromkeys(FAULTS, 3) | {"e_stop": 0}
    return Explored("ratms", "kinematic", 1, 40, 3000.0, 55.0, 30.0, 100.0, reached, {}, list(broken))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What was explored; seed 66 is broken."""
    requests: list[dict[str, Any]] = []

    def explore(workflow: str, seed: int, sessions: int | None, **given: Any) -> Explored:
        given.pop("progress")
        requests.append({"workflow": workflow, "seed": seed, "sessions": sessions} | given)
        return explored(BROKEN) if seed == 66 else explored()

    monkeypatch.setattr(exploring, "explore", explore)
    return requests


def run(*words: str) -> Result:
    return CliRunner().invoke(main, ["faults", "explore", *words])


@pytest.mark.parametrize(
    ("words", "sessions", "minutes"),
    [((), 500, None), (("--minutes", "2"), None, 2.0), (("--minutes", "2", "--sessions", "9"), 9, 2.0)],
)
def test_500_sessions_are_run_unless_time_or_number_is_given(
    asked: list[dict[str, Any]], words: tuple[str, ...], sessions: int | None, minutes: float | None
) -> None:
    assert run(*words).exit_code == 0
    assert (asked[0]["sessions"], asked[0]["minutes"], asked[0]["workers"]) == (sessions, minutes, Workers(2))


def test_faults_that_were_never_injected_are_marked(asked: list[dict[str, Any]]) -> None:
    ended = run()
    lines = [" ".join(line.split()) for line in ended.stdout.splitlines()]
    assert "e_stop B5 never" in lines
    assert "cut_robot B1 3" in lines
    assert "All invariants held after every event." in lines
    assert "3000 s simulated in 30 s: 100 times real time." in " ".join(ended.stdout.split())


def test_a_broken_session_is_shown_and_its_script_written(asked: list[dict[str, Any]], tmp_path: Path) -> None:
    ended = run("--seed", "66", "-o", str(tmp_path / "broken"))
    assert ended.exit_code == 1
    text = " ".join(ended.stdout.split())
    assert "seed 7: stop_holds at 3.250 s: The arm moves at [0.2] rad/s." in text
    assert "2 of 20 acts show it: 1. after 0.500 s ben: stop 2. after 1.000 s fault:e_stop on=True" in text
    assert read_script(tmp_path / "broken" / "ratms-7-stop_holds.json") == SCRIPT


@pytest.mark.parametrize("invariant", ["", "stop_holds"])
def test_one_script_is_run_alone(
    asked: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, invariant: str
) -> None:
    found = ExplorationResult(7, 12.5, 0.5, "abcd", 30, {}, {}, invariant, "It moves [fast].", 3.0)
    monkeypatch.setattr(session, "run_session", lambda script: msgspec.structs.replace(found, seed=script.seed))
    write_script(SCRIPT, tmp_path / "script.json")
    ended = run("--script", str(tmp_path / "script.json"))
    assert (ended.exit_code, asked) == (int(bool(invariant)), [])
    text = " ".join(ended.stdout.split())
    assert "Session of seed 7, 12.5 s simulated, 30 rows, abcd" in text
    assert ("stop_holds at 3.000 s: It moves [fast]." if invariant else "held") in text
    printed = run("--script", str(tmp_path / "script.json"), "--json")
    assert json.loads(printed.stdout)["invariant"] == invariant


def test_a_file_that_is_no_script_has_its_own_exit_status(tmp_path: Path) -> None:
    (tmp_path / "script.json").write_text("{}")
    ended = run("--script", str(tmp_path / "script.json"))
    assert ended.exit_code == 4
    assert "is not a script of a session" in " ".join(ended.stderr.split())


@pytest.mark.parametrize("words", [("--workers", "0"), ("--workers", "65"), ("--sessions", "0"), ("--physics", "real")])
def test_impossible_requests_are_usage_errors(asked: list[dict[str, Any]], words: tuple[str, ...]) -> None:
    assert run(*words).exit_code == 2
    assert asked == []
