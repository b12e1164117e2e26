"""What MuJoCo has to say goes to the log, not into the user's folder."""

from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from pcmrs.kinematics.arms import ARMS
from sim.arm import Arm
from sim.phantoms import PHANTOMS
from sim.settings import ArmSettings, GeometrySettings


def test_an_unstable_simulation_is_logged_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flange_from_coil = GeometrySettings().flange_from_coil.transform
    arm = Arm(ARMS["iiwa14"], ArmSettings(), flange_from_coil, PHANTOMS["head"], np.random.default_rng(1))
    arm._data.qvel[:] = 1e30
    with capture_logs() as logged:
        arm.step(1)
    assert "unstable" in logged[0]["text"]
    assert list(tmp_path.iterdir()) == []
