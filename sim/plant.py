"""The arm with its coil as MuJoCo models: the plant as it is, and the controller's idea of it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import structlog

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.spatial import Transform
from sim.settings import ArmSettings

STEP = 0.001
"""Time of one physics and one control step, s."""
COIL_MASS = 1.0  # kg: a figure-of-eight coil without its cable
COIL_RADIUS = 0.05  # m
COIL_HALF_THICKNESS = 0.01  # m

log = structlog.get_logger(__name__)

# By itself MuJoCo writes its warnings to a file in whatever folder it was started in.
mujoco.set_mju_user_warning(lambda text: log.warning("mujoco", text=text))


def plant_model(facts: ArmFacts, settings: ArmSettings, flange_from_coil: Transform) -> Any:
    """The arm as it is, with friction in its joints, as an ``mujoco.MjModel``."""
    return _compile(
        mjcf(facts, damping=settings.damping, armature=settings.armature, frictionloss=settings.friction),
        flange_from_coil,
    )


def nominal_model(facts: ArmFacts, settings: ArmSettings, flange_from_coil: Transform, rng: np.random.Generator) -> Any:
    """The controller's model: it knows no friction, and every link's mass and inertia is a little wrong."""
    model = _compile(mjcf(facts, damping=0.0, armature=settings.armature, frictionloss=0.0), flange_from_coil)
    factors = 1.0 + settings.inertia_error * rng.choice((-1.0, 1.0), model.nbody)
    model.body_mass *= factors
    model.body_inertia *= factors[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _compile(text: str, flange_from_coil: Transform) -> Any:
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # The cell has nothing to touch: contact would only cost time.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    flange = spec.site("flange")
    coil = flange.parent.add_body(
        name="coil",
        pos=flange.pos + flange_from_coil.translation,  # the flange is parallel to the last link
        quat=flange_from_coil.quat_wxyz,
    )
    coil.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[COIL_RADIUS, COIL_HALF_THICKNESS, 0.0], mass=COIL_MASS)
    return spec.compile()
