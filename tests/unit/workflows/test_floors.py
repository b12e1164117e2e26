"""How near an arm may come on its way, worked out in parts: Stop does not wait for all of them."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.settings import Settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.collision_checks import SAMPLES_PER_PART, ClearanceLimits
from pcmrs.workflows.opening import open_workflow
from pcmrs.workflows.planning import PlanningCell
from pcmrs.workflows.surface import read_surface

SAMPLES = 10 * SAMPLES_PER_PART + 7


@pytest.fixture(scope="module")
def cell() -> Cell:
    settings = Settings()
    planning = PlanningCell(
        open_workflow(settings.workflow),
        settings.procedure,
        ArmModel(find_arm(settings.robot.model)),
        read_surface(settings.procedure),
    )
    return planning._cell


async def test_parts_find_what_the_whole_way_shows(cell: Cell) -> None:
    home = np.array(cell.home)
    turn = np.array([0.9, 0.4, 0.0, -0.5, 0.0, 0.3, 0.0])
    way = home + np.linspace(0.0, 1.0, SAMPLES)[:, None] * turn
    limits = await ClearanceLimits.along_motion(cell, way)
    planned = cell.zones.sample_clearance(way).distances.min(axis=0)
    np.testing.assert_allclose(limits._limits, ClearanceLimits(cell, planned)._limits, atol=2e-3)
    at_home = ClearanceLimits.at_posture(cell, home)._limits
    np.testing.assert_allclose(at_home, ClearanceLimits(cell, cell.zones.sample_clearance([home]).distances[0])._limits)


async def test_loop_runs_between_the_parts(cell: Cell) -> None:
    way = np.tile(cell.home, (SAMPLES, 1))
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    counting = asyncio.create_task(count())
    await ClearanceLimits.along_motion(cell, way)
    counting.cancel()
    assert turns >= SAMPLES // SAMPLES_PER_PART
