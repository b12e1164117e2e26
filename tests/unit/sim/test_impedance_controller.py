"""Torques of the impedance controller, against terms that MuJoCo computes independently."""

import mujoco
import numpy as np
import pytest

from pcmrs.spatial import Floats
from pcmrs_sim.head import HEAD
from pcmrs_sim.impedance_controller import DAMPING_RATIO, ImpedanceController
from pcmrs_sim.plant import STEP, nominal_model
from pcmrs_sim.settings import ArmSettings, GeometrySettings
from tests.unit.sim.simulated_arms import FACTS, HOME

SETTINGS = ArmSettings()
STIFFNESS = np.array(FACTS.stiffness)
REST = np.zeros(7)
ERROR = np.array((0.01, -0.02, 0.0, 0.005, 0.0, 0.01, -0.01))
FLANGE_FROM_TOOL_TIP = GeometrySettings().flange_from_tool_tip.transform
MODEL = nominal_model(FACTS, SETTINGS, FLANGE_FROM_TOOL_TIP, HEAD, np.random.default_rng(1))


def controller(settings: ArmSettings = SETTINGS) -> ImpedanceController:
    return ImpedanceController(MODEL, FACTS, settings, HOME)


def standing(posture: Floats) -> Floats:
    return np.stack((posture, REST, REST))


def weight(posture: Floats) -> Floats:
    """Torques that hold the arm against gravity, N m."""
    data = mujoco.MjData(MODEL)
    data.qpos[:] = posture
    mujoco.mj_forward(MODEL, data)
    return np.array(data.qfrc_bias)


def test_without_error_the_torque_carries_the_weight() -> None:
    assert controller().torque(standing(HOME), HOME, REST) == pytest.approx(weight(HOME), abs=1e-9)


def test_an_error_adds_stiffness_and_grows_by_the_integral() -> None:
    control = controller()
    torques = np.array([control.torque(standing(HOME), HOME - ERROR, REST) for _ in range(50)])
    assert control.error == pytest.approx(ERROR)
    step = STIFFNESS * SETTINGS.integral_rate * STEP * ERROR
    expected = weight(HOME) + STIFFNESS * ERROR + np.arange(1, 51)[:, None] * step
    assert torques == pytest.approx(expected, abs=1e-9)


def test_the_damping_has_its_ratio_at_home() -> None:
    """Each joint alone is an oscillator of its stiffness and its inertia."""
    data = mujoco.MjData(MODEL)
    data.qpos[:] = HOME
    mujoco.mj_forward(MODEL, data)
    inertia = np.zeros((7, 7))
    mujoco.mj_fullM(MODEL, data, inertia)
    velocity = np.full(7, 0.1)
    damping = (
        controller().torque(standing(HOME), HOME, REST) - controller().torque(standing(HOME), HOME, velocity)
    ) / 0.1
    assert damping / (2.0 * np.sqrt(STIFFNESS * np.diag(inertia))) == pytest.approx(np.full(7, DAMPING_RATIO))


def test_the_error_is_unknown_before_the_first_step() -> None:
    """An arm that was never measured does not count as at rest."""
    assert np.isinf(controller().error).all()


def test_configured_stiffness_replaces_that_of_the_arm() -> None:
    soft = controller(ArmSettings(stiffness=(100.0,) * 7, integral_rate=0.0))
    assert soft.torque(standing(HOME), HOME - ERROR, REST) - weight(HOME) == pytest.approx(100.0 * ERROR, abs=1e-9)
