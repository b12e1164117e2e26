"""The golden journals are decided again as they were, and a changed rule shows in them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.clock import SystemClock
from pcmrs.dispatcher import Workflow
from pcmrs.dispatcher.locks import LockManager
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.replay import ReplayReport
from pcmrs.replay._history import read_runs
from pcmrs.replay.replay import replay_runs
from tests.support.ratms_oracle import BLUEPRINT
from tests.support.shipped import shipped_blueprint, shipped_workflow
from tests.unit.replay.golden import GOLDEN, WORKFLOWS

RATMS = GOLDEN / "ratms.jsonl"
TEXT = BLUEPRINT.read_text()

BROKEN_RULES = {
    "a stop is never acknowledged": ("unlatches = true\n", ""),
    "an approach needs no registration": (
        'motion = "approach"\nrequires = { registration = ["111"], toolplan = ["1"], robot = ["1"] }\n'
        'checks = ["calibration_valid", "approach_possible"]',
        'motion = "approach"\nrequires = { toolplan = ["1"], robot = ["1"] }\n'
        'checks = ["calibration_valid", "approach_possible"]',
    ),
    "registering needs no digitization": (
        '[branches.registration.operations.register]\nfrom = ["110", "111"]',
        '[branches.registration.operations.register]\nfrom = ["000", "100", "110", "111"]',
    ),
    "any index is a landmark": ('checks = ["calibration_valid", "landmark_exists"]', 'checks = ["calibration_valid"]'),
    "any landmarks are a plan": ('checks = ["landmarks_spread"]\n', ""),
    "a failed motion stays where it was": ('on_failure = "held"\n', ""),
}


def decided_again(journal: Path, workflow: Workflow[Any, Any]) -> ReplayReport:
    return replay_runs(str(journal), read_runs(journal), lambda _: workflow, SystemClock())


def broken(old: str, new: str) -> ReplayReport:
    """The golden journal of RATMS, decided by a blueprint with another text, sound or not."""
    assert old in TEXT, "the mutation has no place any more"
    mutant, _ = read_blueprint(TEXT.replace(old, new).encode(), "mutant")
    assert mutant is not None
    return decided_again(RATMS, replace(shipped_workflow("ratms"), blueprint=mutant))


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_a_golden_journal_is_decided_again_as_it_was(workflow: str) -> None:
    journal = GOLDEN / f"{workflow}.jsonl"
    replayed = decided_again(journal, shipped_workflow(workflow))
    assert {run.tag.hash for run in read_runs(journal)} == {shipped_blueprint(workflow).hash}
    assert replayed.differences == []
    assert replayed.runs == 2
    assert replayed.compared > 100


@pytest.mark.parametrize("rule", BROKEN_RULES)
def test_a_broken_rule_of_the_blueprint_is_found(rule: str) -> None:
    assert broken(*BROKEN_RULES[rule]).differences


def _never_latched(self: Procedure[Any, Any]) -> None:
    self.sequence = self.reserve()


@pytest.mark.parametrize(
    ("where", "name", "instead"),
    [
        (Procedure, "latch", _never_latched),
        (LockManager, "blocked", lambda *_: False),
        (LockManager, "why_not_wait", lambda *_: None),
    ],
    ids=["Stop does not latch", "no locks", "motions wait"],
)
def test_a_broken_rule_of_the_dispatcher_is_found(
    where: type, name: str, instead: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, name, instead)
    assert decided_again(RATMS, shipped_workflow("ratms")).differences


def test_another_limit_is_found(tmp_path: Path) -> None:
    """Checks of data are performed for real, with the settings on record."""
    lines = [json.loads(line) for line in RATMS.read_text().splitlines()]
    for line in lines:
        settings = (line["row"].get("result") or {}).get("settings")
        if settings is not None:
            settings["procedure"]["registration"]["residual_limit_mm"] = 0.001
    changed = tmp_path / "changed.jsonl"
    changed.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    found = decided_again(changed, shipped_workflow("ratms")).differences
    assert any("registration.register" in each.row and each.recorded == "accepted" for each in found)


# -- the command line ----------------------------------------------------------------------------------


def run(*words: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, ["journal", "replay", *words])
    return result.exit_code, result.stdout, result.stderr


def test_the_status_is_0_where_all_is_the_same() -> None:
    status, out, _ = run(str(RATMS), "--json")
    report = json.loads(out)
    assert (status, report["differences"]) == (0, [])
    assert report["rows_per_second"] > 0


def test_the_status_is_1_and_differences_are_listed(tmp_path: Path) -> None:
    blueprint = tmp_path / "ratms.toml"
    blueprint.write_text(
        TEXT.replace(
            '[branches.registration.operations.plan_landmarks]\nfrom = ["*"]',
            '[branches.registration.operations.plan_landmarks]\nfrom = ["000"]',
        )
    )
    status, out, _ = run(str(RATMS), "--blueprint", str(blueprint))
    assert status == 1
    assert "registration.plan_landmarks" in out
    assert "invalid_in_state" in out


def test_the_status_is_5_where_the_blueprint_is_another_one(tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    other.write_text(RATMS.read_text().replace(shipped_blueprint("ratms").hash, "0" * 64))
    status, _, err = run(str(other))
    assert status == 5
    assert "--blueprint" in err


@pytest.mark.parametrize("words", [(), ("--blueprint", str(BLUEPRINT))], ids=["its-own", "another"])
def test_a_journal_names_no_file_whose_code_is_run(words: tuple[str, ...], tmp_path: Path) -> None:
    """Whoever sends a journal, and a folder with it, must not run code on the machine where it is decided anew."""
    (tmp_path / "sent.toml").write_text(TEXT)
    (tmp_path / "sent.py").write_text(f"import pathlib; pathlib.Path({str(tmp_path / 'was_run')!r}).touch()\n")
    journal = tmp_path / "sent.jsonl"
    journal.write_text(RATMS.read_text().replace('"id":"ratms"', f'"id":"{tmp_path / "sent.toml"}"'))
    status, _, err = run(str(journal), *words)
    assert not (tmp_path / "was_run").exists()
    if not words:
        assert (status, len(err.splitlines())) == (5, 1)
        assert "sent.toml" in err


@pytest.mark.parametrize("content", [b"", b"no journal", b'{"sequence": 1}\n'])
def test_the_status_is_5_for_what_is_no_journal(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(content)
    status, out, err = run(str(file))
    assert (status, out) == (5, "")
    assert str(file) in err
    assert len(err.splitlines()) == 1


def test_the_status_is_5_where_a_row_is_missing(tmp_path: Path) -> None:
    lines = RATMS.read_text().splitlines(keepends=True)
    file = tmp_path / "cut.jsonl"
    file.write_text("".join(lines[:3] + lines[4:]))
    status, _, err = run(str(file))
    assert status == 5
    assert "row 4" in err
