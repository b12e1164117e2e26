"""The cell and the clock of a replay know what was journalled, and nothing else."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import PcmrsError
from pcmrs.replay._world import NotJournalledError, ReplayCell, ReplayClock, RowsClock
from pcmrs.testing.clock import settle
from pcmrs.workflows.settings import CalibrationSettings, ProcedureSettings
from tests.unit.replay.rows import event

SETTINGS = ProcedureSettings(patient="P-17")


@pytest.mark.parametrize("name", ["robot", "poses", "clock", "joints", "image_from_tool_tip", "zones", "stimulator"])
def test_what_was_measured_is_not_known(name: str) -> None:
    with pytest.raises(NotJournalledError, match=name):
        getattr(ReplayCell(SETTINGS, "c0ffee"), name)
    assert not issubclass(NotJournalledError, PcmrsError), "it would be taken for a refusal"


def test_settings_and_identity_of_calibrations_are_known() -> None:
    cell = ReplayCell(SETTINGS, "c0ffee")
    assert cell.settings.patient == "P-17"
    assert cell.calibration_id == "c0ffee"
    assert cell.calibrations() == {"tool": "explicit", "tip": "explicit", "pointer": "explicit"}


def test_identity_that_was_not_journalled_follows_from_the_poses() -> None:
    other = ProcedureSettings(calibration=CalibrationSettings(reference_serial="R-2"))
    assert ReplayCell(SETTINGS, None).calibration_id == ReplayCell(other, None).calibration_id
    with_file = ProcedureSettings(calibration=CalibrationSettings(tool_file="tool.toml", tip_file="tip.toml"))
    with pytest.raises(NotJournalledError):
        _ = ReplayCell(with_file, None).calibration_id
    assert ReplayCell(with_file, "c0ffee").calibration_id == "c0ffee"


async def test_the_dispatcher_sees_the_times_of_rows_and_no_deadline() -> None:
    clock = RowsClock()
    clock.show(event("warm"))
    assert (clock.monotonic(), clock.wall()) == (10.0, 1.8e9)
    async with clock.timeout(0.0):
        pass


async def test_a_timer_of_the_dispatcher_never_expires() -> None:
    """What followed when it did is in the rows."""
    waiting = asyncio.ensure_future(RowsClock().sleep(0.0))
    await settle()
    assert not waiting.done()
    waiting.cancel()


async def test_checks_and_steps_cannot_wait() -> None:
    with pytest.raises(NotJournalledError, match="sleep of 2"):
        await ReplayClock().sleep(2.0)


def test_checks_and_steps_cannot_read_a_time() -> None:
    """The time at which they did was not journalled."""
    clock = ReplayClock()
    clock.show(event("warm"))
    for read in (clock.monotonic, clock.wall):
        with pytest.raises(NotJournalledError):
            read()
