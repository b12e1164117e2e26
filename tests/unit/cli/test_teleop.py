"""What `pcmrs teleop` says."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.cli.teleop import report_line, status_line
from pcmrs.messages import DeviceEvent, Reason, TeleopStatus, Verdict

STATUS = TeleopStatus(
    stamp=1.0,
    user="anna",
    sequence=7,
    round_trip=0.0521,
    jitter=0.0034,
    scale=0.8,
    distance=0.0712,
    height=0.07,
    turn=0.0175,
    limit="range",
    refused={"expired": 2, "other_user": 1},
)


def test_teleoperator_sees_delay_speed_place_and_limit_in_a_line() -> None:
    delay, place = "52 ms ± 3, speed 80 %", "71.2 mm and 1.0° from the plan, 70.0 mm above, as far as allowed"
    assert status_line(STATUS) == f"engaged by anna, {delay}, {place}, 3 refused"
    assert status_line(TeleopStatus(stamp=1.0)) == "clutch open"
    assert status_line(None) == "waiting for the cell"
    held = TeleopStatus(stamp=1.0, user="anna", round_trip=0.6, jitter=0.0, scale=0.0, held=True)
    assert "release the clutch once" in status_line(held)


def test_refusals_and_dangers_are_shown_with_their_reason() -> None:
    reason = Reason(code="not_guided", text="teleoperation.engage needs placement in guided; it is in held.")
    verdict = Verdict(
        id="1", branch="teleoperation", operation="engage", decision="rejected", state="off", sequence=1, reason=reason
    )
    assert report_line(verdict) == f"teleoperation.engage was rejected: {reason.text}"
    lost = DeviceEvent(device="activity:teleoperate", code="teleoperator_lost", text="No set point.", danger=True)
    assert report_line(lost) == "teleoperator_lost: No set point."


@pytest.mark.parametrize("words", [["--device", "script"], ["--device", "keyboard", "--script", "pyproject.toml"]])
def test_a_script_and_its_device_need_each_other(words: list[str]) -> None:
    result = CliRunner().invoke(main, ["teleop", *words])
    assert result.exit_code == 2
    assert "need each other" in result.output
