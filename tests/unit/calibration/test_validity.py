"""When a calibration may be used."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import msgspec
import pytest

from pcmrs.calibration import Calibration, ExpectedCalibration, check_valid
from pcmrs.errors import RefusalError
from tests.unit.calibration.calibrations import DATE, a_pointer, a_tool

HERE = ExpectedCalibration(cell="lab/cell1", tool_type="coil")
NOW = DATE + timedelta(days=10)


def refused(calibration: Calibration, expected: ExpectedCalibration = HERE, days: float = 10.0) -> RefusalError:
    with pytest.raises(RefusalError) as refusal:
        check_valid(calibration, expected, (DATE + timedelta(days=days)).timestamp())
    return refusal.value


@pytest.mark.parametrize("given", [{}, {"cell": ""}, {"serial": ""}])
@pytest.mark.parametrize("make", [a_tool, a_pointer])
def test_own_present_and_unchanged_it_may_be_used(make: Any, given: dict[str, str]) -> None:
    check_valid(make(**given), HERE, NOW.timestamp())


def test_the_mounted_serial_must_be_the_calibrated_one() -> None:
    check_valid(a_tool(serial="17"), ExpectedCalibration("lab/cell1", "coil", serial="17"), NOW.timestamp())
    error = refused(a_tool(serial="17"), ExpectedCalibration("lab/cell1", "coil", serial="18"))
    assert (error.refusal_code, error.fields["field"]) == ("calibration_foreign", "serial")


@pytest.mark.parametrize(
    ("given", "field"), [({"cell": "lab/cell2"}, "cell"), ({"type": "drill_guide"}, "type")], ids=["cell", "type"]
)
def test_of_another_cell_or_type_it_is_refused(given: dict[str, str], field: str) -> None:
    error = refused(a_tool(**given))
    assert (error.refusal_code, error.fields["field"]) == ("calibration_foreign", field)
    assert "procedure.calibration.tool_file" in error.text


def test_a_pointer_serves_every_workflow() -> None:
    check_valid(a_pointer(), ExpectedCalibration("lab/cell1", "drill_guide"), NOW.timestamp())


def test_it_expires_to_the_second() -> None:
    end = (DATE + timedelta(days=100)).timestamp()
    check_valid(a_tool(), HERE, end - 1.0)
    with pytest.raises(RefusalError) as refusal:
        check_valid(a_tool(), HERE, end)
    assert refusal.value.refusal_code == "calibration_expired"
    assert refusal.value.fields["valid_days"] == 100
    error = refused(a_pointer(), days=112.5)
    assert "expired 12 days ago" in error.text
    assert "pcmrs calibrate pivot" in error.text


def test_calibration_from_the_future_is_refused() -> None:
    """Clocks that differ by less than an hour are allowed."""
    check_valid(a_tool(), HERE, (DATE - timedelta(minutes=59)).timestamp())
    assert refused(a_tool(), days=-1.0).refusal_code == "calibration_in_future"


@pytest.mark.parametrize("given", [{"valid_days": 10_000}, {"cell": ""}, {"error_mm": 0.0}, {"sha256": ""}])
def test_changed_file_is_refused_before_its_values_are_used(given: dict[str, Any]) -> None:
    error = refused(msgspec.structs.replace(a_tool(cell="elsewhere/cell"), **given), days=5000.0)
    assert error.refusal_code == "calibration_changed"
