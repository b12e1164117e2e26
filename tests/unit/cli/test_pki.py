"""`pcmrs pki`: what is issued is shown as it is, and nothing half is left where it cannot be issued."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from pcmrs.bus.access import roles_as_markdown
from pcmrs.bus.seal import read_key
from tests.unit.cli.command_line import run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    assert run("pki", "init", "--folder", str(tmp_path / "pki")).exit_code == 0
    return tmp_path / "pki"


def issue(folder: Path, name: str, *words: str, role: str = "operator") -> Result:
    return run("pki", "issue", role, name, "--folder", str(folder), "-o", str(folder.parent), *words)


def listed(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(run("pki", "list", "--folder", str(folder), "--json").stdout)
    return found


def test_a_list_shows_who_may_what_and_until_when(folder: Path) -> None:
    assert issue(folder, "anna", "--cell", "lab/cell1", "--cell", "or/*", "--via", "gate").exit_code == 0
    assert issue(folder, "ben", "--cell", "lab/*", "--days", "0.00001", role="viewer").exit_code == 0
    run("pki", "revoke", "anna", "--folder", str(folder))
    anna, ben = listed(folder)
    assert (anna["name"], anna["cells"], anna["via"]) == ("anna", ["lab/cell1", "or/*"], ["gate"])
    assert anna["revoked"] is not None
    assert ben["ends"] - ben["begins"] < 3600.0 * 24.0
    shown = run("pki", "list", "--folder", str(folder)).stdout
    assert "lab/cell1 or/*" in shown
    assert "revoked" in shown


@pytest.mark.parametrize(
    ("name", "words"),
    [("a/b", ("--cell", "lab/c")), ("local", ("--cell", "lab/c")), ("anna", ("--cell", "lab"))],
)
def test_what_cannot_be_issued_leaves_nothing(folder: Path, name: str, words: tuple[str, ...]) -> None:
    before = sorted(folder.parent.iterdir())
    ended = issue(folder, name, *words)
    assert ended.exit_code == 4
    assert len(ended.stderr.splitlines()) == 1
    assert listed(folder) == []
    assert sorted(folder.parent.iterdir()) == before


def test_a_device_key_is_new_private_and_never_replaced(tmp_path: Path) -> None:
    file = tmp_path / "device.key"
    assert run("pki", "device-key", str(file)).exit_code == 0
    assert file.stat().st_mode & 0o777 == 0o600
    key = read_key(file)
    assert key.hex() not in run("pki", "device-key", str(file)).output
    assert run("pki", "device-key", str(file)).exit_code == 4
    assert read_key(file) == key
    assert run("pki", "device-key", str(tmp_path / "none" / "device.key")).exit_code == 5


def test_printed_roles_are_the_table_of_the_access_control() -> None:
    ended = run("pki", "roles")
    assert ended.stdout == roles_as_markdown()
    assert json.loads(run("pki", "roles", "--json").stdout)
