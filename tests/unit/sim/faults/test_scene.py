"""Faults of the patient: what moves, by how much, and which sizes are refused."""

import numpy as np
import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ARMS
from pcmrs.spatial import distance
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import inject
from pcmrs_sim.faults.scene import BURST_DURATION, FAULTS, LARGEST_BUMP_MM, LARGEST_SHIFT_MM, LARGEST_SPEED_MM
from pcmrs_sim.settings import ArmSettings, SimSettings


@pytest.fixture
def still_cell() -> CellSimulation:
    settings = SimSettings(arm=ArmSettings(physics="kinematic"))
    return CellSimulation(settings, ARMS["iiwa14"], ForceSettings(), SystemClock())


def test_a_bump_moves_the_reference_and_not_the_patient(still_cell: CellSimulation) -> None:
    world = still_cell.world
    patient, reference = world.tracker_from_image, world.tracker_from_body_ref()
    inject(still_cell, "bump_reference", {"millimetres": 5.0})
    assert distance(world.tracker_from_image, patient) == 0.0
    assert distance(world.tracker_from_body_ref(), reference) == pytest.approx(0.005)


def test_a_shift_moves_patient_and_reference_together(still_cell: CellSimulation) -> None:
    world = still_cell.world
    patient, registration = world.tracker_from_image, world.body_ref_from_image
    inject(still_cell, "shift_body", {"millimetres": -40.0})
    assert world.tracker_from_image.translation - patient.translation == pytest.approx([-0.04, 0.0, 0.0])
    assert world.body_ref_from_image is registration


def test_a_dash_has_its_speed_for_its_time(still_cell: CellSimulation) -> None:
    world = still_cell.world
    start = world.tracker_from_image.translation
    inject(still_cell, "dash_head", {"millimetres_per_second": 80.0})
    ways = []
    for _ in range(200):  # strides as short as the tracker's period
        world.step(10)
        ways.append(world.tracker_from_image.translation - start)
    halfway = ways[round(BURST_DURATION / 2 / 0.010) - 1]
    assert halfway == pytest.approx([0.08 * BURST_DURATION / 2, 0.0, 0.0], abs=1e-3)
    assert ways[-1] == pytest.approx([0.08 * BURST_DURATION, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("fault", "argument", "value"),
    [
        ("bump_reference", "millimetres", LARGEST_BUMP_MM + 1.0),
        ("shift_body", "millimetres", -LARGEST_SHIFT_MM - 1.0),
        ("dash_head", "millimetres_per_second", LARGEST_SPEED_MM + 1.0),
        ("dash_head", "millimetres_per_second", None),
    ],
)
def test_a_size_out_of_range_is_refused_and_moves_nothing(
    still_cell: CellSimulation, fault: str, argument: str, value: float | None
) -> None:
    pose = still_cell.world.tracker_from_body_ref().matrix.copy()
    with pytest.raises(DeviceError, match=argument) as refused:
        inject(still_cell, fault, {argument: value})
    assert (refused.value.fields["argument"], refused.value.fields["value"]) == (argument, value)
    still_cell.world.step(100)
    assert np.array_equal(still_cell.world.tracker_from_body_ref().matrix, pose)


def test_every_row_of_the_patient_has_its_fault() -> None:
    assert {row for fault in FAULTS for row in fault.rows} == {"S5", "S6", "S12", "B6"}
