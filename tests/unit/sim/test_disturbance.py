"""Disturbances of the arm: offsets that joints take slowly, and a push as a force in the physics."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats
from pcmrs_sim.cell_model import cell_model
from pcmrs_sim.disturbance import OFFSET_SPEED, Disturbance, PlantDisturbance
from pcmrs_sim.head import HEAD
from pcmrs_sim.plant import STEP
from pcmrs_sim.settings import SimSettings
from tests.unit.sim.simulated_arms import FACTS, HOME

offsets = st.lists(st.floats(-0.2, 0.2), min_size=7, max_size=7).map(np.array)
COMMANDED = np.stack((HOME, np.zeros(7), np.zeros(7)))


def course(disturbance: Disturbance, steps: int) -> Floats:
    return np.array([disturbance.apply_offset(COMMANDED)[0] - HOME for _ in range(steps)])


@given(offsets)
def test_joints_take_their_offset_no_faster_than_stated(offset: Floats) -> None:
    disturbance = Disturbance(7)
    disturbance.offset = offset
    ways = np.vstack((np.zeros(7), course(disturbance, round(0.2 / (OFFSET_SPEED * STEP)) + 2)))
    assert ways[-1] == pytest.approx(offset, abs=1e-12)
    assert np.abs(np.diff(ways, axis=0)).max() <= OFFSET_SPEED * STEP + 1e-12


def test_an_offset_that_is_ended_acts_until_the_joint_is_back() -> None:
    disturbance = Disturbance(7)
    assert disturbance.inactive
    disturbance.offset = np.array((0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0))
    course(disturbance, 200)
    disturbance.offset = np.zeros(7)
    assert not disturbance.inactive
    assert course(disturbance, 200)[-1] == pytest.approx(np.zeros(7), abs=1e-12)
    assert disturbance.inactive


def test_without_offset_the_commanded_sample_is_followed() -> None:
    assert Disturbance(7).apply_offset(COMMANDED) is COMMANDED


@pytest.mark.parametrize("push", [20.0, -20.0])
def test_a_push_is_the_transposed_jacobian_times_the_force(push: float) -> None:
    """The force is along the tool's +z, at its marker body."""
    model = cell_model(FACTS, SimSettings(), HEAD)
    data = mujoco.MjData(model)
    data.qpos[:] = HOME
    mujoco.mj_forward(model, data)
    disturbance = PlantDisturbance(model)
    disturbance.push = push
    assert disturbance.apply(data) == push
    tool, jacobian = model.body("tool").id, np.zeros((3, 7))
    mujoco.mj_jac(model, data, jacobian, None, data.xpos[tool], tool)
    assert data.qfrc_applied == pytest.approx(jacobian.T @ (push * data.xmat[tool].reshape(3, 3)[:, 2]))
    disturbance.push = 0.0
    assert disturbance.apply(data) == 0.0
    assert not data.qfrc_applied.any()
