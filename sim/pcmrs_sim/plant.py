"""The arm with its tool in MuJoCo, and the controller's nominal model of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import structlog

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.spatial import Transform
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.settings import ArmSettings
from pcmrs_sim.shape import Shape

STEP = 0.001
"""Duration of a physics step, which is also a control step, s."""

log = structlog.get_logger(__name__)

# By default, MuJoCo writes its warnings to a file in the working directory.
mujoco.set_mju_user_warning(lambda text: log.warning("mujoco", text=text))


def nominal_model(
    facts: ArmFacts, settings: ArmSettings, flange_from_tool: Transform, phantom: Phantom, rng: np.random.Generator
) -> Any:
    """Return the controller's model, without friction and with errors of each link's inertia, as an ``mujoco.MjModel``.

    Args:
        facts: Nominal geometry and inertias of the arm.
        settings: Armature of the joints, and relative error of masses and inertias.
        flange_from_tool: Pose of the tool on the flange.
        phantom: Phantom with the tool.
        rng: Source of the signs of the errors.
    """
    text = mjcf(facts, damping=0.0, armature=settings.armature, frictionloss=0.0)
    model = arm_with_tool(text, flange_from_tool, phantom.tool).compile()
    factors = 1.0 + settings.inertia_error * rng.choice((-1.0, 1.0), model.nbody)
    model.body_mass *= factors
    model.body_inertia *= factors[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def arm_with_tool(text: str, flange_from_tool: Transform, shapes: Sequence[Shape]) -> Any:
    """Return an ``mujoco.MjSpec`` of an arm with the body ``tool`` on its flange.

    Args:
        text: MJCF of the arm, with a site ``flange``.
        flange_from_tool: Pose of the tool on the flange.
        shapes: Shapes of the tool, in its frame.
    """
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # `pcmrs_sim.contact` computes the contact of tool and body. Any other contact would only cost time.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    flange = spec.site("flange")
    link_from_tool = Transform.from_quat_wxyz(flange.pos, flange.quat) @ flange_from_tool
    tool = flange.parent.add_body(name="tool", pos=link_from_tool.translation, quat=link_from_tool.quat_wxyz)
    for shape in shapes:
        add_shape(tool, shape)
    return spec


def add_shape(body: Any, shape: Shape, **options: Any) -> None:
    """Add a primitive to a body of an ``mujoco.MjSpec``.

    Args:
        body: The body, an ``mujoco.MjsBody``.
        shape: Shape with its mass, in the body's frame.
        **options: Further attributes of the geom, such as its colour.
    """
    body.add_geom(
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
        pos=shape.pose.translation,
        quat=shape.pose.quat_wxyz,
        size=[*shape.size, 0.0, 0.0][:3],
        mass=shape.mass,
        **options,
    )
