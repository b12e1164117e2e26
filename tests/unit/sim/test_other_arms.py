"""Arms from URDF in the simulated cell."""

import asyncio

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import joint_motion
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.opening import open_devices
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plan import make_plans
from pcmrs_sim.settings import SimSettings

STANDOFF = 0.070  # m along +z of the tool
CLEAR = 0.28  # m from the middle of the body, from where on a way may also come nearer

every_arm = pytest.mark.parametrize("name", ["panda", "ur5"])


def limits(joints: int) -> MotionLimits:
    return MotionLimits(
        joint_velocity=(0.7,) * joints,
        joint_acceleration=(2.5,) * joints,
        joint_jerk=(15.0,) * joints,
        linear_velocity=0.2,
        linear_acceleration=0.5,
        linear_jerk=3.0,
        angular_velocity=0.6,
        angular_acceleration=1.5,
    )


@every_arm
async def test_arm_stands_at_home_and_follows_to_rest_at_its_goal(name: str, clock: Clock) -> None:
    arm = ArmModel(find_arm(name))
    home = np.array(arm.facts.home)
    async with open_devices(("robot",), {"robot": {"model": name}}, clock) as devices:
        state = await devices["robot"].connect()
        np.testing.assert_allclose(state.positions, home, atol=1e-3)
        assert len(state.velocities) == len(state.torques) == arm.joints
        goal = home + 0.1 * (-1.0) ** np.arange(arm.joints)
        result = await devices["robot"].follow(joint_motion(arm, state.positions, goal, limits(arm.joints)))
        assert result.outcome == "done"
        np.testing.assert_allclose(result.positions, goal, atol=1e-4)
        following = asyncio.create_task(
            devices["robot"].follow(joint_motion(arm, result.positions, home, limits(arm.joints)))
        )
        await clock.sleep(0.3)
        held = await devices["robot"].hold()
        assert (await following).outcome == "stopped"
        assert np.abs(np.subtract(held.positions, home)).max() > 0.01


@every_arm
@pytest.mark.parametrize(("body", "workflow"), [("head", "ratms"), ("femur", "femoroplasty")])
def test_example_poses_are_reachable_and_the_way_home_leads_away(name: str, body: str, workflow: str) -> None:
    arm, phantom = ArmModel(find_arm(name)), PHANTOMS[body]
    home = np.array(arm.facts.home)
    for plan in make_plans()[workflow]["poses"]:
        pose = Transform.from_quat_xyzw(plan["position"], plan["quat_xyzw"])
        standoff = posture(arm, phantom, pose, STANDOFF, home)
        assert np.abs(posture(arm, phantom, pose, 0.0, standoff) - standoff).max() < 0.35  # no other branch
        ways = standoff + np.linspace(0.0, 1.0, 101)[:, None] * (home - standoff)
        distances = np.array([distance_from_middle(arm, phantom, q) for q in ways])
        assert np.diff(distances)[distances[:-1] < CLEAR].min() > 0.0
        assert distances[-1] > 0.5


def posture(arm: ArmModel, phantom: Phantom, pose: Transform, offset: float, seed: Floats) -> Floats:
    flange_from_tool = SimSettings().geometry.flange_from_coil.transform
    tool_from_offset = Transform.from_rotvec((0.0, 0.0, offset), (0.0, 0.0, 0.0))
    return inverse(arm, phantom.world_from_image @ pose @ tool_from_offset @ flange_from_tool.inverse(), seed)


def distance_from_middle(arm: ArmModel, phantom: Phantom, q: Floats) -> float:
    tool = arm.forward(q) @ SimSettings().geometry.flange_from_coil.transform
    return float(np.linalg.norm(tool.translation - phantom.world_from_image @ phantom.inside))


@pytest.mark.parametrize("key", ["home", "stiffness"])
async def test_settings_for_another_number_of_joints_are_refused(key: str, clock: Clock) -> None:
    settings = {"robot": {"model": "ur5"}, "sim": {"arm": {key: [1.0] * 7}}}
    with pytest.raises(ConfigurationError, match=rf"sim\.arm\.{key} holds 7 numbers; ur5 has 6 joints"):
        async with open_devices(("robot",), settings, clock):
            pass
