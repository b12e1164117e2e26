"""The benchmarks whose figures documents and issues name still run, on a few commands."""

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
