"""The benchmarks whose figures documents and issues name still run, on a few commands."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.timeout(120)
def test_the_time_to_a_decision_is_measured() -> None:
    command = [sys.executable, str(BENCHMARKS / "dispatch.py"), "--count", "3", "--warm-up", "0"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    assert measured.stdout.count("accepted and committed") == 4  # over UDP and Zenoh, with and without fsync
    assert "aim for an accepted command" in measured.stdout


@pytest.mark.timeout(180)
def test_nothing_moves_after_a_confirmed_stop_at_a_random_moment() -> None:
    pytest.importorskip("mujoco")
    command = [sys.executable, str(BENCHMARKS / "stop.py"), "--stops", "3", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    found = json.loads(measured.stdout)
    assert found["not confirmed"] == 0
    assert found["moved after confirmed, deg"]["n"] == 3
    assert found["ms"]["asked to hold sent"]["n"] == 3


def test_the_cost_of_the_seal_is_measured() -> None:
    command = [sys.executable, str(BENCHMARKS / "seal.py"), "--count", "10", "--json"]

    measured = subprocess.run(command, capture_output=True, text=True, check=False)

    assert measured.returncode == 0, measured.stderr
    assert {"seal", "check", "bare HMAC"} <= json.loads(measured.stdout)["state/joints"].keys()
