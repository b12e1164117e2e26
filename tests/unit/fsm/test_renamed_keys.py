"""Keys of a blueprint under their old names: accepted with a warning, and the same content for a journal."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import BlueprintError
from pcmrs.fsm import load_blueprint, parse_blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.files.load import examine
from tests import ROOT

BIOPSY = ROOT / "examples/biopsy/biopsy.toml"
HASH = "683b43326884"
"""Of the biopsy as the first versions wrote it, with `acts`: journals name it."""

PUMP = """
id = "pump"
version = "1"
[branches.pump.states]
off = "off"
on = "on"
[branches.pump.operations]
start = { from = ["off"], to = "on", steps = ["start_pump"], %s }
stop = { from = ["on"], to = "off" }
acknowledge = { from = ["*"], to = { off = "off", on = "on" }, unlatches = true }
"""


def test_the_content_of_an_old_file_is_that_of_the_renamed_one() -> None:
    new = BIOPSY.read_text()
    old = new.replace("affects_patient = true", "acts = true")
    assert old != new
    assert parse_blueprint(old.encode()) == parse_blueprint(new.encode())
    assert parse_blueprint(new.encode()).hash.startswith(HASH)


def test_old_name_is_accepted_with_a_warning_naming_the_new_one() -> None:
    found = examine(PUMP.replace("%s", "acts = true").encode(), origin="pump.toml")
    assert found.sound
    assert [str(each) for each in found.warnings] == [
        "pump.toml:8:62: old_key: `acts` is now called `affects_patient`: rename it."
    ]
    assert not examine((PUMP % "affects_patient = true").encode()).warnings


def test_verify_shows_the_warning_and_reports_sound(tmp_path: Path) -> None:
    file = tmp_path / "pump.toml"
    file.write_text(PUMP % "acts = true")
    result = CliRunner().invoke(main, ["fsm", "verify", str(file)])
    assert (result.exit_code, "old_key" in result.stderr, "sound" in result.stdout) == (0, True, True)


def test_a_key_under_both_names_is_refused() -> None:
    with pytest.raises(BlueprintError, match="unknown field `acts`"):
        parse_blueprint((PUMP % "acts = true, affects_patient = false").encode())


def test_each_layer_of_an_extended_file_may_have_its_own_names(tmp_path: Path) -> None:
    (tmp_path / "pump.toml").write_text(PUMP % "acts = true")
    (tmp_path / "slow.toml").write_text(
        'extends = "pump.toml"\nid = "slow"\nversion = "1"\n'
        "[branches.pump.operations.start]\naffects_patient = true\ntimeout_s = 60\n"
    )
    warned: list[str] = []
    blueprint = load_blueprint(tmp_path / "slow.toml", warn=lambda warning: warned.append(warning.file))
    assert blueprint.branches["pump"].operations["start"].affects_patient
    assert warned == [str(tmp_path / "pump.toml")]


def test_moves_alone_is_an_approach_and_is_barred_if_latched() -> None:
    blueprint = parse_blueprint((PUMP % 'moves = true, on_failure = "on", on_unknown = "on"').encode())
    start = blueprint.branches["pump"].operations["start"]
    assert (start.moves, start.motion, start.blocked_when_latched) == (True, "approach", True)


def test_implied_keys_are_not_written_and_others_are() -> None:
    implied = parse_blueprint((PUMP % "affects_patient = true").encode())
    barred = parse_blueprint((PUMP % "blocked_when_latched = true").encode())
    assert "blocked_when_latched" not in blueprint_toml(implied)
    assert "blocked_when_latched = true" in blueprint_toml(barred)
    assert len({implied.hash, barred.hash}) == 2
