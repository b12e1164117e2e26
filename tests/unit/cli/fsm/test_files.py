"""Files that `pcmrs fsm` reads and writes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import click
import pytest

from pcmrs.cli.fsm.files import check_json_output, conclude, fetch, printable
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.finding import unreadable_file
from tests.unit.cli.command_line import run


def test_name_means_the_installed_workflow_not_a_local_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is verified is what a daemon would run."""
    (tmp_path / "ratms").write_text("not a blueprint")
    monkeypatch.chdir(tmp_path)
    assert run("fsm", "verify", "ratms").exit_code == 0
    assert run("fsm", "verify", "./ratms").exit_code == 5


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path: Path) -> None:
    reasons = {str(tmp_path / "none.toml"): "No such file", str(tmp_path) + "/": "irectory", "a\0b.toml": "null"}
    for file, reason in reasons.items():
        with pytest.raises(ConfigurationError, match=reason) as error:
            fetch(file)
        assert error.value.fields == {"file": file}


def test_origin_and_folder_are_those_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_bytes(b"x = 1\n")
    assert fetch(str(tmp_path / "own.toml")) == (b"x = 1\n", str(tmp_path / "own.toml"), tmp_path)


def test_a_name_that_is_no_text_can_be_printed() -> None:
    name = os.fsdecode(b"caf\xe9.toml")
    assert printable(name).encode() == b"caf\\udce9.toml"
    with pytest.raises(ConfigurationError) as error:
        fetch(name)
    error.value.text.encode()


@pytest.mark.parametrize(("readable", "status"), [(True, 1), (False, 5)])
def test_findings_end_a_command_as_text_or_as_one_object(
    readable: bool, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    findings = [unreadable_file("own.toml", "It has no branches.")]
    for as_json in (False, True):
        with pytest.raises(SystemExit) as ended:
            conclude("own.toml", findings, readable=readable, as_json=as_json, combinations=2**70)
        assert ended.value.code == status
        out, err = capsys.readouterr()
        if as_json:
            found = json.loads(out)
            assert (found["sound"], found["readable"], found["combinations"]) == (False, readable, 2**70)
        else:
            assert out == ""
            assert "It has no branches." in err
    conclude("own.toml", [], readable=True, as_json=True)
    assert json.loads(capsys.readouterr().out)["sound"] is True


def test_json_and_blueprint_are_not_mixed_on_standard_output() -> None:
    check_json_output(Path("-"), as_json=False)
    check_json_output(Path("own.toml"), as_json=True)
    with pytest.raises(click.UsageError, match="give -o a file"):
        check_json_output(Path("-"), as_json=True)
