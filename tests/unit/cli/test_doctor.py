"""`pcmrs doctor`: the exit status is the worst finding, and every line says what to do."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.cli.doctor import doctor
from pcmrs.doctor import Examination


@pytest.mark.parametrize(("floor", "status"), [("0", (0, 1)), ("1e12", (5,))])
def test_the_status_tells_the_worst_and_every_line_what_to_do(
    tmp_path: Path, floor: str, status: tuple[int, ...]
) -> None:
    free = ["gateway.planner.port=0", "gateway.robot.port=0", "gateway.visualization.port=0", "gateway.mep.port=0"]
    free += ["gateway.tcp_port=0", "console.enabled=false", "cell.endpoint=tcp/127.0.0.1:0"]
    words = [f"--set={each}" for each in (f"cell.folder={tmp_path}", f"journal.least_free_mb={floor}", *free)]

    told = CliRunner().invoke(doctor, [*words, "--json"])
    shown = CliRunner().invoke(doctor, words)

    found = msgspec.json.decode(told.stdout, type=Examination)
    assert told.exit_code in status
    assert found.verdict == {0: "good", 1: "warning", 5: "bad"}[told.exit_code]
    assert all(bool(each.remedy) == (each.verdict != "good") for each in found.findings)
    assert {"real-time policy", "kernel", "time of fsync", "free space", "certificates"} <= {
        each.check for each in found.findings
    }
    assert "free space" in shown.stdout
    assert list(tmp_path.iterdir()) == []  # it only looks
