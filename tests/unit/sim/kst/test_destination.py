"""Set points of a direct servo, and when it ends."""

import numpy as np
import pytest

from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.destination import LARGEST_JUMP
from tests.unit.sim.kst_client import DONE, NAK, ROUNDING, KstClient, at_rest, line

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest.mark.parametrize("joint_2", [LARGEST_JUMP * 1.1, 3.0])
async def test_a_set_point_too_far_away_ends_the_servo(cell: CellSimulation, client: KstClient, joint_2: float) -> None:
    start = np.array(await client.joints())
    assert await client.ask("startDirectServoJoints") == DONE
    wrong = start.copy()
    wrong[1] += joint_2
    client.send(line("jf", wrong))
    assert await client.reply() == NAK
    await at_rest(cell)
    assert np.allclose(await client.joints(), start, atol=ROUNDING)
    assert await client.ask("startDirectServoJoints") == DONE
