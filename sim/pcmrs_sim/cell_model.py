"""The simulated cell as one MuJoCo model: arm, tool, patient, pointer with hand, marker bodies, table and tracker.

Its sensors are the one source of all true positions, its rays of what the tracker sees, and its pictures of what a
person sees. The contact of tool and body is not part of it: see `pcmrs_sim.contact`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import mujoco
import numpy as np

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.error_models import BASELINE
from pcmrs_sim.markers import MARKER_BODIES, PLATE_DISTANCE, PLATE_RADIUS, SPHERE_RADIUS
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plant import add_shape, arm_with_tool
from pcmrs_sim.settings import SimSettings, TrackerSettings
from pcmrs_sim.shape import Capsule, Shape
from pcmrs_sim.surfaces import SURFACES, Ints

OPAQUE, SHOWN, VOLUME = 0, 2, 3
"""Groups of geoms: those that block the tracker's rays, those that are only drawn, and the tracker's measuring volume,
which is drawn on request."""
FRAMES = {
    "world_from_flange": ("flange", None),
    "world_from_tool_tip": ("tool_tip", None),
    "tracker_from_tool_tip": ("tool_tip", "tracker"),
    "tracker_from_pointer_tip": ("pointer_tip", "tracker"),
} | {f"tracker_from_{body}": (body, "tracker") for body in MARKER_BODIES}
"""Pose that is sensed, to the sites of its frames; None for the world."""

_GREY, _WHITE, _BLACK = (0.6, 0.62, 0.65, 1.0), (0.93, 0.93, 0.9, 1.0), (0.12, 0.12, 0.14, 1.0)
_ORANGE, _SKIN, _BONE = (0.9, 0.5, 0.15, 1.0), (0.87, 0.68, 0.57, 1.0), (0.9, 0.87, 0.76, 1.0)
_GLASS = (0.3, 0.6, 0.9, 0.06)
_TABLE = ((0.6, 0.0, -0.33), (0.5, 0.55, 0.02))
"""Middle and half size of the table, m. The person's hand fits between it and the patient."""
_FLOOR = -0.9
"""Height of the floor, m."""
_HOLDER_RADIUS, _POST_RADIUS, _SHAFT_RADIUS, _PLATE_HALF_THICKNESS = 0.012, 0.004, 0.004, 0.0015  # m
_HAND = ((0.04, 0.035, 0.045), 0.06)
"""Semi-axes of the person's hand, and its distance from the middle of the pointer's markers along the shaft, m."""
_PICTURE_SIZE = (1920, 1080)
"""Largest picture that can be rendered, pixels."""


def cell_model(facts: ArmFacts, settings: SimSettings, phantom: Phantom) -> Any:
    """Return the whole cell as an ``mujoco.MjModel``.

    The only joints are those of the arm. Patient (``body``) and pointer are mocap bodies. Each marker body has a site
    of its name, and one site for each sphere, with the sphere's normal as its z: ``coil_0``. Each pose of `FRAMES` has
    two sensors, its position and its quaternion w x y z, which follow each other.

    Args:
        facts: True geometry and inertias of the arm.
        settings: Friction, damping and armature of the joints, and the true poses.
        phantom: The patient, and the tool.
    """
    own, geometry = settings.arm, settings.geometry
    text = mjcf(facts, damping=own.damping, armature=own.armature, frictionloss=own.friction)
    flange_from_tool_tip = geometry.flange_from_tool_tip.transform
    spec = arm_with_tool(text, flange_from_tool_tip, phantom.tool)
    for geom in spec.geoms:
        geom.rgba = _WHITE
    tip_from_marker = geometry.tool_marker_from_tool_tip.transform.inverse()
    _add_tool(spec.body("tool"), flange_from_tool_tip.inverse(), tip_from_marker, phantom)
    _add_patient(spec, settings, phantom)
    _add_pointer(spec.worldbody, geometry.pointer_from_tip.transform)
    _add_tracker(spec, geometry.world_from_tracker.transform, settings.tracker)
    _add_room(spec)
    for name, (frame, reference) in FRAMES.items():
        _add_sensors(spec, name, frame, reference)
    return spec.compile()


def sensor_addresses(model: Any) -> Mapping[str, int]:
    """Return the first index of each pose of `FRAMES` in the sensor data: position, then quaternion w x y z."""
    return {name: int(model.sensor_adr[model.sensor(f"{name}.position").id]) for name in FRAMES}


def _add_tool(tool: Any, tip_from_flange: Transform, tip_from_marker: Transform, phantom: Phantom) -> None:
    """Add the holder from flange to tool, and the marker body on its post."""
    middle = phantom.tool[0].pose.translation
    tool.add_site(name="tool_tip", size=[0.002] * 3)
    _add_capsule(tool, tip_from_flange.translation, middle, _HOLDER_RADIUS, _GREY)
    foot = tip_from_marker @ np.array((0.0, 0.0, -PLATE_DISTANCE))
    _add_capsule(tool, middle, foot, _POST_RADIUS, _BLACK)
    _add_markers(tool, "coil", tip_from_marker)


def _add_patient(spec: Any, settings: SimSettings, phantom: Phantom) -> None:
    """Add the patient with a mesh of its surface, and the marker bodies that are fixed to it."""
    vertices, faces = _surface(phantom)
    spec.add_mesh(name="body", uservert=vertices.ravel(), userface=faces.ravel())
    patient = spec.worldbody.add_body(name="body", mocap=True)
    patient.add_geom(
        name="body",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="body",
        mass=0.0,
        contype=0,  # without contacts the compiler needs no convex hull, which would take most of its time
        conaffinity=0,
        rgba=_SKIN if settings.phantom == "head" else _BONE,
    )
    for name in ("body_ref", "witness"):
        fixed = patient.add_body(name=name)
        _add_markers(fixed, name, Transform.identity())


@cache
def _surface(phantom: Phantom) -> tuple[Floats, Ints]:
    """Return vertices and faces of a phantom, computed once for all cells of this process."""
    return SURFACES[phantom]()


def _add_pointer(world: Any, pointer_from_tip: Transform) -> None:
    """Add the pointer with the hand that holds it."""
    pointer = world.add_body(name="pointer", mocap=True)
    tip, up = pointer_from_tip.translation, pointer_from_tip.rotation[:, 2]
    pointer.add_site(name="pointer_tip", pos=tip, quat=pointer_from_tip.quat_wxyz, size=[0.002] * 3)
    markers = MARKER_BODIES["pointer"]
    foot = markers.plane @ np.array((0.0, 0.0, -PLATE_DISTANCE))
    semi_axes, below = _HAND
    _add_capsule(pointer, tip + _SHAFT_RADIUS * up, foot, _SHAFT_RADIUS, _GREY)
    palm = foot - (below + foot @ up) * up
    hand = Shape("ellipsoid", Transform(pointer_from_tip.rotation, palm), semi_axes)
    add_shape(pointer, hand, name="hand", rgba=_SKIN, contype=0, conaffinity=0)
    _add_markers(pointer, "pointer", Transform.identity())


def _add_markers(body: Any, name: str, body_from_marker: Transform) -> None:
    """Add the site, the spheres and the plate of a marker body.

    The spheres are sites, which rays pass: a ray ends at the centre of a sphere.
    """
    markers = MARKER_BODIES[name]
    body.add_site(name=name, pos=body_from_marker.translation, quat=body_from_marker.quat_wxyz, size=[0.001] * 3)
    plane = body_from_marker @ markers.plane
    for number, centre in enumerate(body_from_marker @ markers.positions):
        size, quat = [SPHERE_RADIUS] * 3, plane.quat_wxyz
        body.add_site(name=f"{name}_{number}", pos=centre, quat=quat, size=size, rgba=_GREY)
    middle = plane @ Transform(np.eye(3), np.array((0.0, 0.0, -PLATE_DISTANCE)))
    plate = Shape("cylinder", middle, (PLATE_RADIUS, _PLATE_HALF_THICKNESS))
    add_shape(body, plate, rgba=_BLACK, contype=0, conaffinity=0)


def _add_capsule(body: Any, start: Floats, end: Floats, radius: float, colour: tuple[float, ...]) -> None:
    """Add a massless rod between two points of a body, m, (3,) each."""
    add_shape(body, Capsule(start, end, radius).shape(), rgba=colour, contype=0, conaffinity=0)


def _add_tracker(spec: Any, world_from_tracker: Transform, settings: TrackerSettings) -> None:
    """Add the tracker, which looks along its -z as a camera of MuJoCo does, and its measuring volume."""
    tracker = spec.worldbody.add_body(
        name="tracker", pos=world_from_tracker.translation, quat=world_from_tracker.quat_wxyz
    )
    tracker.add_site(name="tracker", size=[0.001] * 3)
    tracker.add_camera(name="tracker", fovy=50.0)
    shown = {"group": SHOWN, "mass": 0.0, "contype": 0, "conaffinity": 0}
    box = mujoco.mjtGeom.mjGEOM_BOX
    tracker.add_geom(type=box, pos=[0.0, 0.0, 0.05], size=[0.3, 0.05, 0.04], rgba=_BLACK, **shown)
    for x in (-BASELINE / 2, BASELINE / 2):
        tracker.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=[x, 0.0, 0.01], size=[0.035, 0.006, 0.0], rgba=_ORANGE, **shown
        )
    near, far, half = settings.nearest, settings.farthest, settings.half_width
    corners = [(x * d * half, y * d * half, -d) for d in (near, far) for x in (-1, 1) for y in (-1, 1)]
    spec.add_mesh(name="volume", uservert=np.array(corners).ravel())
    tracker.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="volume", rgba=_GLASS, **shown | {"group": VOLUME})


def _add_room(spec: Any) -> None:
    """Add table, pedestal, floor, light, and the camera ``overview``, which follows the patient."""
    world, (middle, half) = spec.worldbody, _TABLE
    plain = {"contype": 0, "conaffinity": 0}
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=half, rgba=(0.45, 0.5, 0.52, 1.0), **plain)
    pedestal = Shape("cylinder", Transform(np.eye(3), np.array((0.0, 0.0, _FLOOR / 2))), (0.1, -_FLOOR / 2))
    add_shape(world, pedestal, rgba=_GREY, **plain)
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, _FLOOR],
        size=[3.0, 3.0, 0.1],
        rgba=(0.32, 0.36, 0.4, 1.0),
        group=SHOWN,
        **plain,
    )
    world.add_light(pos=[1.0, -1.5, 2.5], dir=[-0.3, 0.6, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    target = mujoco.mjtCamLight.mjCAMLIGHT_TARGETBODY
    world.add_camera(name="overview", pos=[1.35, -1.6, 1.2], mode=target, targetbody="body", fovy=55.0)
    gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky = {"rgb1": [0.75, 0.8, 0.85], "rgb2": [0.93, 0.94, 0.95], "width": 64, "height": 384}
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=gradient, **sky)
    spec.visual.headlight.ambient = [0.35] * 3
    spec.visual.headlight.diffuse = [0.45] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = _PICTURE_SIZE


def _add_sensors(spec: Any, name: str, frame: str, reference: str | None) -> None:
    kinds = {"position": mujoco.mjtSensor.mjSENS_FRAMEPOS, "quaternion": mujoco.mjtSensor.mjSENS_FRAMEQUAT}
    site = mujoco.mjtObj.mjOBJ_SITE
    relative = {} if reference is None else {"reftype": site, "refname": reference}
    for kind, sensor in kinds.items():
        spec.add_sensor(name=f"{name}.{kind}", type=sensor, objtype=site, objname=frame, **relative)
