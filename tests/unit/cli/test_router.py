"""`pcmrs-router` starts with a valid identity and register only, and its configuration is one document for zenohd."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli.router import router
from pcmrs.clock import SystemClock
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority
from pcmrs.router import router_settings


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.init(tmp_path / "pki", "lab", SystemClock().wall())
    made.issue("router", "gate", SystemClock().wall(), hosts=["127.0.0.1"], cells=EVERY_CELL, into=tmp_path)
    made.issue("operator", "anna", SystemClock().wall(), cells=EVERY_CELL, into=tmp_path)
    return made


def run(*words: object) -> Result:
    return CliRunner().invoke(router, [str(word) for word in words])


def test_the_configuration_has_every_setting_at_its_place(authority: Authority, tmp_path: Path) -> None:
    register, listen = authority.folder / "register.json", ("tls/127.0.0.1:1", "tls/127.0.0.1:2")
    ended = run(
        *("--identity", tmp_path / "gate", "--register", register, "--print-config"),
        *(word for endpoint in listen for word in ("--listen", endpoint)),
    )
    assert ended.exit_code == 0, ended.output
    found = json.loads(ended.stdout)
    settings = router_settings(tmp_path / "gate", register, listen).zenoh_config()
    for path, value in settings.items():
        at = found
        for name in path.split("/"):
            at = at[name]
        assert at == json.loads(json.dumps(value)), path
    assert found["mode"] == "router"


def test_only_the_identity_of_a_router_is_taken(authority: Authority, tmp_path: Path) -> None:
    register = authority.folder / "register.json"
    for words in (
        ("--identity", tmp_path / "anna", "--register", register),
        ("--identity", tmp_path / "none", "--register", register),
        ("--identity", tmp_path / "gate", "--register", tmp_path / "none.json"),
    ):
        ended = run(*words, "--print-config")
        assert ended.exit_code == 4
        assert len(ended.stderr.splitlines()) == 1
        assert ended.stdout == ""


def test_without_an_identity_it_says_how_to_issue_one(authority: Authority) -> None:
    ended = run("--register", authority.folder / "register.json")
    assert ended.exit_code == 2
    assert "pcmrs pki issue router" in ended.stderr
