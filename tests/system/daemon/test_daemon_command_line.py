"""``pcmrs`` on a running daemon, and daemons that must not start."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from pcmrs.testing.daemon import free_port
from tests.system.daemon.daemon_process import ServeProcess, as_words, own_settings, run_pcmrs, running_daemon


def test_call_prints_the_verdict_and_its_status_tells_it(daemon: ServeProcess) -> None:
    accepted = daemon.pcmrs("call", "toolplan.clear")
    assert accepted.returncode == 0, accepted.stderr
    assert accepted.stdout.startswith("accepted: toolplan.clear")
    rejected = daemon.pcmrs("call", "placement.confirm", "--json")
    assert rejected.returncode == 1
    verdict = json.loads(rejected.stdout)
    assert verdict["decision"] == "rejected"
    assert verdict["reason"]["text"]
    assert "confirm" not in verdict["allowed"]
    unknown = daemon.pcmrs("call", "registration.explode")
    assert unknown.returncode == 1
    assert "explode" in unknown.stdout
    for ended in (accepted, rejected, unknown):
        assert ended.stderr == ""


@pytest.mark.parametrize("words", [["robot.connect", "{"], ["robot.connect", "[]"], ["robot"], ["Robot.connect"]])
def test_invalid_call_is_refused_in_one_line(daemon: ServeProcess, words: list[str]) -> None:
    ended = daemon.pcmrs("call", *words)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert len(ended.stderr.splitlines()) == 1


def test_the_state_has_its_keys(daemon: ServeProcess) -> None:
    state = json.loads(daemon.pcmrs("state", "--json").stdout)
    keys = {"sequence", "branches", "flags", "running", "activities", "latched", "unknown", "plan", "registration"}
    assert set(state) == keys | {"blueprint", "lease", "release", "stop"}
    branches = ["registration", "digitization", "toolplan", "robot", "placement", "alignment", "teleoperation"]
    assert list(state["branches"]) == branches
    assert state["blueprint"]["id"] == "ratms"
    text = daemon.pcmrs("state").stdout
    assert "registration" in text
    assert "sequence" in text


def test_the_keys_are_listed(daemon: ServeProcess) -> None:
    ended = daemon.pcmrs("keys", "--json")
    assert json.loads(ended.stdout)["prefix"] == daemon.ready.prefix


def test_another_cell_on_the_same_bus_is_not_this_one(daemon: ServeProcess) -> None:
    ended = run_pcmrs("state", "--endpoint", daemon.ready.endpoint, "--site", "test", "--cell", "elsewhere")
    assert ended.returncode == 3
    assert "elsewhere" in ended.stderr


def _starts_not(settings: list[str], status: int, word: str) -> None:
    ended = run_pcmrs("serve", *as_words(settings))
    assert ended.returncode == status, ended.stderr
    assert ended.stdout == ""
    (line,) = [line for line in ended.stderr.splitlines() if "pcmrs.cli serve: " in line]
    assert word in line
    assert "Traceback" not in ended.stderr


def test_a_second_daemon_on_the_same_bus_endpoint_is_refused(daemon: ServeProcess, tmp_path: Path) -> None:
    endpoint = daemon.ready.endpoint
    _starts_not([*own_settings(tmp_path), f"cell.endpoint={endpoint}"], 3, endpoint)


def test_a_second_daemon_of_the_same_cell_is_refused(daemon: ServeProcess) -> None:
    other = f"cell.endpoint=tcp/127.0.0.1:{free_port()}"
    _starts_not([*daemon.settings, other], 4, daemon.ready.folder)


def test_a_second_daemon_on_the_same_link_is_refused(daemon: ServeProcess, tmp_path: Path) -> None:
    _, port = daemon.ready.links["planner"]
    _starts_not([*own_settings(tmp_path), f"gateway.planner={{port={port}}}"], 4, str(port))


def test_files_of_a_cell_are_readable_by_their_owner_only(tmp_path: Path) -> None:
    folder = tmp_path / "cell"
    folder.mkdir(mode=0o755)  # as an earlier version left it
    before = os.umask(0o022)  # as a shell has it
    try:
        with running_daemon(own_settings(folder), tmp_path):
            kept = [folder, *folder.rglob("*")]
            assert len(kept) > 2
            assert {path.name: oct(path.stat().st_mode & 0o077) for path in kept} == {path.name: "0o0" for path in kept}
    finally:
        os.umask(before)


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    _starts_not([*own_settings(tmp_path), f"cell.folder={file / 'cell'}"], 4, "file")
