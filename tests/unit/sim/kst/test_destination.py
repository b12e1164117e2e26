"""Set points of a direct servo, and when it ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.destination import LARGEST_JUMP, Destination, VelocityDestination
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import ArmSettings
from tests.support.trials import examples
from tests.unit.sim.kst_client import DONE, NAK, ROUNDING, KstClient, at_rest, line
from tests.unit.sim.simulated_arms import FACTS, HOME

LOOP = pytest.mark.asyncio(loop_scope="module")


@LOOP
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


SETTINGS = ArmSettings()
jumps = st.lists(st.floats(-0.09, 0.09), min_size=7, max_size=7).map(np.array)


@examples(20)
@given(st.lists(st.tuples(jumps, st.integers(1, 40)), min_size=1, max_size=6), st.sampled_from([0.1, 1.0]))
def test_the_last_set_point_is_reached_within_the_limits(stream: list[tuple[Floats, int]], fraction: float) -> None:
    destination, target, samples = Destination(HOME, FACTS, SETTINGS, fraction), HOME, [HOME]
    for jump, steps in stream:
        target = target + jump
        destination.take(target)
        samples += [destination.advance()[0].copy() for _ in range(steps)]
    assert destination.halt is None
    samples += [destination.advance()[0].copy() for _ in range(9000)]
    assert destination.position == pytest.approx(target, abs=1e-9)
    assert destination.velocity == pytest.approx(np.zeros(7), abs=1e-9)
    fastest = fraction * np.array([joint.velocity for joint in FACTS.joints])
    assert np.all(np.abs(np.diff(samples, axis=0)).max(axis=0) / STEP <= fastest * 1.001)


@pytest.mark.parametrize(("joint", "beyond"), [(1, -1.0), (6, 1.0)])
def test_a_set_point_out_of_the_range_of_a_joint_halts(joint: int, beyond: float) -> None:
    facts = FACTS.joints[joint]
    near = HOME.copy()
    near[joint] = (facts.upper if beyond > 0.0 else facts.lower) - beyond * 0.01
    destination, wrong = Destination(near, FACTS, SETTINGS), near.copy()
    wrong[joint] += beyond * 0.02
    destination.take(wrong)
    assert destination.halt == "out_of_range"
    assert np.array_equal(destination.advance()[0], near), "it was not followed"


def test_a_jump_is_measured_from_the_last_set_point() -> None:
    """A fast stream that the arm lags behind is no jump."""
    destination, target = Destination(HOME, FACTS, SETTINGS, 0.1), HOME
    for _ in range(5):
        target = target + 0.9 * LARGEST_JUMP
        destination.take(target)
        destination.advance()
    assert np.abs(target - destination.position).max() > 2 * LARGEST_JUMP
    assert destination.halt is None


def test_a_joint_turns_with_its_velocity_until_it_must_brake() -> None:
    """It halts where its brake still ends within the range."""
    destination, velocities = VelocityDestination(HOME, FACTS, SETTINGS), np.zeros(7)
    velocities[6] = 0.5
    destination.take(velocities)
    steps = 0
    while destination.halt is None:
        sample = destination.advance().copy()
        steps += 1
        assert np.abs(sample[1]).max() <= 0.5 + 1e-9
    assert destination.halt == "out_of_range"
    assert sample[1][6] == pytest.approx(0.5)
    upper = FACTS.joints[6].upper
    assert 0.0 < upper - sample[0][6] <= 0.5**2 / (2.0 * SETTINGS.brake_acceleration) + 0.5 * STEP


def test_a_velocity_beyond_that_of_the_joint_halts() -> None:
    destination, velocities = VelocityDestination(HOME, FACTS, SETTINGS), np.zeros(7)
    velocities[2] = -1.01 * FACTS.joints[2].velocity
    destination.take(velocities)
    assert destination.halt == "too_fast"
    assert np.array_equal(destination.advance()[0], HOME)
