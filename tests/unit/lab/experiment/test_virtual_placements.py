"""The placement experiment through the drivers of real devices, with a virtual cabinet and a virtual tracker."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

QUICK = (  # motion in real time, but not more of it than the test needs
    "procedure.motion.joint_speed_fraction=1.0",
    "procedure.motion.joint_acceleration=5.0",
    "procedure.motion.linear_velocity=0.5",
    "procedure.registration.samples=5",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)


@pytest.mark.nightly
def test_placements_by_real_drivers_are_as_accurate_as_promised() -> None:
    pytest.importorskip("ndicapy")
    settings = [word for setting in QUICK for word in ("--set", setting)]
    command = ["experiment", "placements", "--drivers", "virtual", "--trials", "2", "--seed", "4", "--json", *settings]
    ended = subprocess.run(
        [sys.executable, "-m", "pcmrs.cli", *command], capture_output=True, text=True, timeout=110, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr
    report = json.loads(ended.stdout)
    assert report["rate"] == 1.0
    assert {"robot.driver=kst", "tracker.driver=ndi", "cell.rate=1"} <= set(report["settings"])
    for trial in report["trials"]:
        assert 0.0 < trial["translation_error_mm"] <= 0.08  # the tolerance of the placement
        assert 0.0 < trial["true_translation_error_mm"] <= 0.25
        assert trial["rotation_error_deg"] <= 0.08
        assert trial["true_rotation_error_deg"] <= 0.5
