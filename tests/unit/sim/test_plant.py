"""The dynamics of the arm: what an unstable simulation leaves behind."""

from pathlib import Path

import pytest
from structlog.testing import capture_logs

from tests.unit.sim.simulated_arms import make_arm


def test_an_unstable_simulation_is_logged_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = make_arm()
    arm._data.qvel[:] = 1e30
    with capture_logs() as logged:
        arm.step(1)
    assert "unstable" in logged[0]["text"]
    assert list(tmp_path.iterdir()) == []
