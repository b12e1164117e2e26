"""`pcmrs session`: what it prints of a session, and the exit status of one that ended early."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.cli.session import session_table
from pcmrs_lab.experiment import threshold_session
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.threshold_session import INTERRUPTED, SessionSummary, report_of
from tests.support.session_records import mesh, nothing, record
from tests.unit.lab.cli.shown import shown


def summary(**changed: Any) -> SessionSummary:
    return msgspec.structs.replace(report_of(record(), Path("sessions/one")), **changed)


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[tuple[SessionSetup, Path]]:
    """Sessions that were requested; each ends at once."""
    requested: list[tuple[SessionSetup, Path]] = []

    async def run(setup: SessionSetup, folder: Path, _progress: object) -> SessionSummary:
        requested.append((setup, folder))
        return summary(ended=ENDED.get(setup.seed, ""))

    monkeypatch.setattr(threshold_session, "run_threshold_session", run)
    monkeypatch.setattr("pcmrs_lab.experiment.session.setup.read_surface", lambda _: mesh())
    return requested


ENDED = {2: "No threshold was found.", 3: INTERRUPTED}
"""Reason for which the session of a seed ends early."""


def session(*words: str) -> Result:
    return CliRunner().invoke(main, ["session", "ratms-threshold", *words])


@pytest.mark.parametrize(("seed", "status"), [("1", 0), ("2", 1), ("3", 130)])
def test_a_session_that_ended_early_has_its_own_exit_status(ran: list[Any], seed: str, status: int) -> None:
    ended = session("--seed", seed, "--json")
    assert ended.exit_code == status
    assert json.loads(ended.stdout)["ended"] == ENDED.get(int(seed), "")


def test_the_default_folder_names_date_subject_and_seed(ran: list[tuple[SessionSetup, Path]]) -> None:
    session("--seed", "5", "--set", "procedure.patient=P17")
    assert re.fullmatch(r"sessions/\d{4}-\d\d-\d\d-P17-5", str(ran[0][1]))


def test_options_become_the_setup_of_the_session(ran: list[tuple[SessionSetup, Path]], tmp_path: Path) -> None:
    words = ("--method", "grid", "--threshold", "relative_frequency", "--ceiling", "60", "--rate", "2")
    session(*words, "--output", str(tmp_path / "out"))
    (setup, folder) = ran[0]
    assert (setup.method, setup.threshold, setup.ceiling, setup.rate) == ("grid", "relative_frequency", 60.0, 2.0)
    assert folder == tmp_path / "out"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--method", "grid", "--budget", "5"), "--budget"),
        (("--budget", "0"), "--budget"),
        (("--ceiling", "nan"), "--ceiling"),
        (("--ceiling", "10"), "--ceiling"),
        (("--rate", "0"), "--rate"),
        (("--seed", "-1"), "--seed"),
    ],
)
def test_impossible_sessions_are_usage_errors(ran: list[Any], words: tuple[str, ...], named: str) -> None:
    ended = session(*words)
    assert (ended.exit_code, ran) == (2, [])
    assert named in ended.stderr


def test_the_command_refuses_a_folder_in_use(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    ended = session("--output", str(tmp_path))
    assert ended.exit_code == 4
    assert "not empty" in ended.stderr


def test_results_are_shown_with_their_uncertainty_and_truth() -> None:
    text = " ".join(shown(session_table(summary(threshold=49.5, threshold_low=47.0, threshold_high=52.0))).split())
    assert "49.5 %, 95 % interval 47 % to 52 %" in text
    assert "known within" in text
    assert "ended early" not in text


def test_what_was_not_found_is_said_so() -> None:
    text = shown(session_table(report_of(nothing(), Path("sessions/none"))))
    assert text.count("not found") == 2
    assert "0, mean error –" in text
    assert "it was interrupted." in text


def test_a_folder_with_brackets_is_shown_as_it_is() -> None:
    """Rich would take them for a style, and leave them out."""
    text = shown(session_table(summary(folder="sessions/p[bold]1", ended="It said [/nothing].")))
    assert "sessions/p[bold]1" in text
    assert "It said [/nothing]." in text


def test_asking_for_help_loads_no_experiment() -> None:
    code = "import sys, pcmrs_lab.cli.session; sys.exit('pcmrs_lab.experiment.threshold_session' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
