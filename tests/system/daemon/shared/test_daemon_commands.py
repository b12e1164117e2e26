"""``pcmrs`` on a running daemon."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from tests.system.daemon.daemon_process import ServeProcess, run_pcmrs, wait_until


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
def test_invalid_call_is_a_usage_error(daemon: ServeProcess, words: list[str]) -> None:
    address = ("--endpoint", daemon.ready.endpoint, "--site", "test", "--cell", daemon.cell)
    ended = CliRunner().invoke(main, ["call", *address, *words])
    assert ended.exit_code == 2
    assert ended.stdout == ""
    assert ended.stderr.splitlines()[-1].startswith("Error: Invalid value")


def test_operations_have_arguments_and_say_what_is_allowed(daemon: ServeProcess) -> None:
    found = {row["operation"]: row for row in json.loads(daemon.pcmrs("operations", "--json").stdout)}
    assert found["robot.connect"]["arguments"] == []
    assert found["toolplan.clear"]["allowed"]
    assert not found["placement.confirm"]["allowed"]
    assert found["placement.confirm"]["why_not"]
    (index,) = found["digitization.digitize_one"]["arguments"]
    assert (index["name"], index["kind"], index["required"]) == ("index", "integer", True)
    assert "alignment.within" not in found, "only a detector reports it"
    shown = daemon.pcmrs("operations", "digitization").stdout
    assert "index: integer" in shown
    assert "robot.connect" not in shown
    unknown = daemon.pcmrs("operations", "arm")
    assert (unknown.returncode, "no branch 'arm'" in unknown.stderr) == (2, True)


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


def test_healthy_daemon_has_status_0_and_an_absent_one_has_3(daemon: ServeProcess) -> None:
    assert wait_until(lambda: daemon.pcmrs("health").returncode == 0)
    ended = run_pcmrs("health", "--endpoint", daemon.ready.endpoint, "--site", "test", "--cell", "elsewhere")
    assert ended.returncode == 3
    assert ended.stdout == ""
    assert "elsewhere" in ended.stderr
