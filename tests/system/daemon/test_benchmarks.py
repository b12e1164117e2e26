"""The benchmarks whose figures documents and issues name still run, on a few commands."""

import json
import subprocess
import sys

import pytest

from tests import ROOT

BENCHMARKS = ROOT / "benchmarks"


@pytest.mark.timeout(120)
@pytest.mark.parametrize(("fsync", "tables"), [("with", 1), pytest.param("both", 2, marks=pytest.mark.nightly)])
def test_the_time_to_a_decision_is_measured(fsync: str, tables: int) -> None:
    command = [sys.executable, str(BENCHMARKS / "dispatch.py"), "--count", "3", "--warm-up", "0", "--fsync", fsync]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    assert measured.stdout.count("accepted and committed") == 2 * tables  # over UDP and Zenoh
    assert "aim for an accepted command" in measured.stdout


@pytest.mark.timeout(300)
def test_nothing_moves_after_a_confirmed_stop_at_a_random_moment() -> None:
    pytest.importorskip("mujoco")
    pytest.importorskip("nicegui")
    words = ["real", "floods", "--stops", "2", "--flood", "stop-puts", "--pressed", "2"]
    words += ["--jobs", "1", "--untimed", "--json"]

    measured = subprocess.run(
        [sys.executable, str(BENCHMARKS / "stop.py"), *words], capture_output=True, text=True, check=False
    )

    assert measured.returncode == 0, measured.stdout + measured.stderr
    found = json.loads(measured.stdout)
    assert found["wrong"] == []
    assert found["real"]["moved after confirmed, deg"]["n"] == 2
    assert found["real"]["ms"]["stop received to hold sent"]["n"] == 2
    assert found["real"]["ms"]["asked to begun, flood of stop-puts"]["n"] == 4
    assert found["real"]["notes"]["messages per second of stop-puts"] > 1000


UNGUARDED = """
import json
from pcmrs.devices.gate import Gate
from stop_simulated import run_cell

guarded, _ = run_cell(1, 5)
Gate.check = Gate.admit = lambda gate, token: None
unguarded, _ = run_cell(1, 5)
print(json.dumps({"guarded": guarded.report() | {"wrong": guarded.wrong}, "unguarded": unguarded.wrong}))
"""
"""The same Stops of one cell in simulated time, with the gate of its node and without."""


@pytest.mark.timeout(120)
def test_stop_benchmark_sees_motion_after_a_confirmed_stop() -> None:
    command = [sys.executable, "-c", UNGUARDED]

    measured = subprocess.run(command, capture_output=True, text=True, check=False, cwd=BENCHMARKS)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert (found["guarded"]["wrong"], found["guarded"]["moved after confirmed, deg"]["n"]) == ([], 5)
    assert any("rad after a confirmed Stop" in each for each in found["unguarded"]), found["unguarded"]


BUSY = """
from stop_found import BRAKING, Found

found = Found()
found.times[BRAKING] = [0.025]
print(*([len(texts) for texts in (found.late([late]), found.not_judged([late]))] for late in (0.0, 0.01, 0.03)))
"""


def test_stop_benchmark_judges_no_limit_on_a_busy_machine() -> None:
    """The timer's lateness is added to a limit: beyond the limit itself, it would permit anything."""
    command = [sys.executable, "-c", BUSY]

    measured = subprocess.run(command, capture_output=True, text=True, check=False, cwd=BENCHMARKS)

    assert measured.stdout.strip() == "[1, 0] [0, 0] [0, 1]", measured.stderr


def test_the_cost_of_the_seal_is_measured() -> None:
    command = [sys.executable, str(BENCHMARKS / "seal.py"), "--count", "10", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    assert {"seal", "check", "bare HMAC"} <= json.loads(measured.stdout)["state/joints"].keys()


def test_the_code_is_counted_and_one_command_is_followed() -> None:
    command = [sys.executable, str(BENCHMARKS / "house.py"), "--route", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert found["files on the route of a command"] < found["files"]
    assert found["calls on the route of a command"] >= found["functions on the route of a command"] > 50


def test_archiving_and_questions_are_measured() -> None:
    words = ["--sessions", "4", "--rows", "300", "--cells", "2", "--verify", "--json"]
    command = [sys.executable, str(BENCHMARKS / "archive.py"), *words]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert found["add"]["rows"] == 1200
    answers = {name: answer["rows"] for name, answer in found["ask"].items()}
    assert answers == {
        "stops": 4,
        "errors-by-tool": 2,
        "errors-by-site": 2,
        "decisions": answers["decisions"],
        "sessions": 4,
    }


def test_processes_of_a_cell_at_rest_are_measured() -> None:
    pytest.importorskip("mujoco")
    command = [sys.executable, str(BENCHMARKS / "rest.py"), "--seconds", "1", "--settle", "0", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert {"daemon", "node"} <= {each["process"] for each in found["processes"]}
    assert found["total"]["pss_mb"] > 0.0


def test_commands_to_the_whole_daemon_are_measured() -> None:
    pytest.importorskip("mujoco")
    words = ["--count", "3", "--rounds", "1", "--ram", "--quiet-cell", "--without-chain", "--json"]
    command = [sys.executable, str(BENCHMARKS / "command.py"), *words]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    assert json.loads(measured.stdout).keys() == {"echo", "accepted", "rejected", "commit"}


def test_start_and_command_line_are_measured() -> None:
    pytest.importorskip("mujoco")
    command = [sys.executable, str(BENCHMARKS / "start.py"), "--runs", "1", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert found["answer"] > found["python"] > 0.0
