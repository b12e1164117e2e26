"""Pointer and tool are calibrated on a running simulated cell, where a second process does what a person would."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration import read_calibration
from pcmrs.client import Client
from pcmrs.spatial import distance, rotation_angle
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings
from tests import ROOT
from tests.system.daemon.daemon_process import ServeProcess, own_settings, running_daemon

PERSON = ROOT / "examples" / "calibrating_person.py"

LONGEST = 240.0
"""That a calibration may take on a machine that does much else, s."""


def address(daemon: ServeProcess) -> tuple[str, ...]:
    return ("--endpoint", daemon.ready.endpoint, "--site", "test", "--cell", daemon.cell)


def calibrate(daemon: ServeProcess, *words: str) -> subprocess.CompletedProcess[str]:
    """The command on the running cell."""
    command = [sys.executable, "-m", "pcmrs.cli", "calibrate", *words, "--live", "--json", *address(daemon)]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)


@contextmanager
def person(daemon: ServeProcess, kind: str) -> Iterator[None]:
    """Somebody at the cell, who leaves with the context."""
    acting = subprocess.Popen([sys.executable, str(PERSON), kind, *address(daemon)])
    try:
        yield
    finally:
        acting.terminate()
        acting.wait()


@pytest.mark.nightly
async def test_the_tip_is_found_where_the_simulation_has_it(
    daemon: ServeProcess, client: Client, tmp_path: Path
) -> None:
    with person(daemon, "pivot"):
        ended = calibrate(daemon, "pivot", "--poses", "30", "--name", "stylus", "-o", str(tmp_path / "stylus.toml"))
    await client.request_device("pointer", "release")
    assert ended.returncode == 0, ended.stderr
    true = np.array((await client.request_device("scene", "truth"))["tip_in_pointer"])
    told, found = json.loads(ended.stdout), read_calibration(tmp_path / "stylus.toml")
    assert np.linalg.norm(found.transform().translation - true) < 0.2e-3
    assert found.transform().translation == pytest.approx(told["tip_in_pointer"], abs=1e-9)
    assert max(told["deviations"]) < 0.1e-3
    assert found.error_mm < 0.5


def test_a_pointer_that_nobody_holds_is_not_calibrated(daemon: ServeProcess) -> None:
    ended = calibrate(daemon, "pivot", "--seconds", "2")
    assert ended.returncode == 1
    assert json.loads(ended.stdout)["reason"]["code"] == "not_enough_poses"


@pytest.mark.nightly
def test_the_tool_is_found_where_the_simulation_has_it(tmp_path: Path) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon, person(daemon, "hand-eye"):
        ended = calibrate(daemon, "hand-eye", "--poses", "8", "-o", str(tmp_path / "coil.toml"))
        assert ended.returncode == 0, ended.stderr
        assert "Traceback" not in daemon.log
    true = Mounting.read(CalibrationSettings()).flange_from_tool_marker
    found = read_calibration(tmp_path / "coil.toml")
    assert json.loads(ended.stdout)["bad"] == []
    assert distance(found.transform(), true) < 0.5e-3
    assert rotation_angle(found.transform(), true) < math.radians(0.05)
    assert found.error_mm < 0.5
