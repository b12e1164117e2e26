"""Measurements of the virtual cabinet, in its units, and their replies over a real socket."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.model import ArmModel
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.head import HEAD
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.kst.readings import Readings, from_xyzabc, to_xyzabc
from pcmrs_sim.settings import SimSettings
from tests.unit.sim.kst_client import DONE, NUMBER, KstClient, at_rest
from tests.unit.sim.simulated_arms import FACTS

LOOP = pytest.mark.asyncio(loop_scope="module")

MODEL = ArmModel(FACTS)


@LOOP
@pytest.mark.parametrize(
    ("question", "count"),
    [
        ("getJointsPositions", 7),
        ("Torques_ext_J", 7),
        ("Torques_m_J", 7),
        ("Eef_pos", 6),
        ("Eef_force", 3),
        ("Eef_moment", 3),
    ],
)
async def test_questions_are_answered_with_so_many_numbers(client: KstClient, question: str, count: int) -> None:
    assert re.fullmatch(rb"(%s){%d}\n" % (NUMBER, count), await client.ask(question))


@LOOP
async def test_the_pose_is_in_millimetres_and_of_the_tool_frame(client: KstClient) -> None:
    flange = from_xyzabc(await client.values("Eef_pos"))
    assert await client.ask("TFtrans_10.0_20.0_150.0_0.5_0.0_3.14159") == DONE
    tool = from_xyzabc(await client.values("Eef_pos"))
    joints = await client.joints()
    assert np.allclose(flange.matrix, MODEL.forward(joints).matrix, atol=1e-6)
    expected = MODEL.forward(joints) @ from_xyzabc([10.0, 20.0, 150.0, 0.5, 0.0, 3.14159])
    assert np.allclose(tool.matrix, expected.matrix, atol=1e-6)


@LOOP
async def test_a_push_on_the_tool_shows_in_forces_and_torques(cell: CellSimulation, client: KstClient) -> None:
    cell.world.arm.disturbance.push = 20.0
    try:
        await cell.clock.sleep(0.3)
        await at_rest(cell)
        force = np.array(await client.values("Eef_force"))
        torques = np.array(await client.values("Torques_ext_J"))
        joints = await client.joints()
    finally:
        cell.world.arm.disturbance.push = 0.0
    assert np.allclose(force, [0.0, 0.0, -20.0], atol=1.0)  # the tool's +z is the flange's -z
    expected = MODEL.jacobian(joints)[:3].T @ MODEL.forward(joints).rotation @ force
    assert np.allclose(torques, expected, atol=1.0)


coordinates = st.tuples(*[st.floats(-2000.0, 2000.0)] * 3)
angles = st.tuples(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0))


@given(coordinates, angles)
def test_six_numbers_come_back_from_their_pose(place: tuple[float, ...], turn: tuple[float, ...]) -> None:
    assert to_xyzabc(from_xyzabc([*place, *turn])) == pytest.approx([*place, *turn], abs=1e-6)


def test_the_moment_is_that_of_the_flange_force_about_the_tool() -> None:
    """In the base frame it is the lever from the tool's origin to the flange, times the force."""
    arm = KinematicArm(FACTS, SimSettings(), ForceSettings(), HEAD)
    arm.disturbance.push = 20.0
    arm.step(10)
    readings = Readings(arm, MODEL)
    readings.flange_from_tool = from_xyzabc([30.0, -20.0, 150.0, 0.4, 0.3, -0.2])
    base_from_flange = MODEL.forward(arm.positions)
    base_from_tool = base_from_flange @ readings.flange_from_tool
    force = base_from_flange.rotation @ np.array(arm.sensor.flange_force)
    moment = np.cross(base_from_flange.translation - base_from_tool.translation, force)
    assert base_from_tool.rotation @ readings.force() == pytest.approx(force)
    assert np.linalg.norm(force) == pytest.approx(20.0)
    assert base_from_tool.rotation @ readings.moment() == pytest.approx(moment)
