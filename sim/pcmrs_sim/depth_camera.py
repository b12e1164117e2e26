"""Depth camera of the simulated cell: an image of arm, body, bench and a hand, by casting a ray for each pixel."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Final

import mujoco
import numpy as np

from pcmrs.clock import Clock, SystemClock
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.scene.depth_frame import DepthFrame, Image, Intrinsics
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.settings import read_settings
from pcmrs_sim.shape import Shape
from pcmrs_sim.surfaces import SURFACES

INTRINSICS: Final = Intrinsics(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5)
"""A quarter of the resolution of a usual depth camera, with its field of view."""
FARTHEST: Final = 4.0
"""Largest depth that the camera measures, m."""
NOISE: Final = 0.002
"""Standard deviation of the depth at 1 m, m; it grows with the square of the depth, as that of stereo cameras."""
HAND: Final = ((0.05, 0.08), (0.04, 0.14))
"""Radius and half length of the capsules of hand and forearm, m."""
AWAY: Final = (0.0, 0.0, -5.0)
FLOOR: Final = -0.75
"""Height of the floor below the robot's base, m."""
BENCH: Final = ((0.4, 0.0, -0.145), (0.7, 0.7, 0.025))
"""Middle and half edges of the bench, m; as the zone ``table`` of the default configuration."""


class DepthImager:
    """Casts a ray for each pixel of a camera into a MuJoCo model.

    Args:
        model: Model, ``mujoco.MjModel``.
        data: Its state, ``mujoco.MjData``; the caller moves it, and calls `mujoco.mj_kinematics`.
        intrinsics: Pinhole model of the camera.
        world_from_camera: Pose of the camera: z along the optical axis, x right in the image, y down.
    """

    def __init__(self, model: Any, data: Any, intrinsics: Intrinsics, world_from_camera: Transform) -> None:
        self._model, self._data = model, data
        self._shape = (intrinsics.height, intrinsics.width)
        rays = intrinsics.rays().reshape(-1, 3)
        lengths = np.linalg.norm(rays, axis=1)
        self._along = 1.0 / lengths
        self._directions = np.ascontiguousarray((rays / lengths[:, None]) @ world_from_camera.rotation.T).ravel()
        self._origin = world_from_camera.translation.copy()
        self._geoms = np.full(len(rays), -1, dtype=np.int32)
        self._distances = np.zeros(len(rays))

    def image(self) -> Image:
        """Return the depth along the optical axis, m, (height, width); 0 where nothing is within `FARTHEST`."""
        mujoco.mj_multiRay(
            self._model,
            self._data,
            self._origin,
            self._directions,
            None,
            1,
            -1,
            self._geoms,
            self._distances,
            None,
            len(self._distances),
            FARTHEST,
        )
        seen = self._geoms >= 0
        return np.where(seen, self._distances * self._along, 0.0).astype(np.float32).reshape(self._shape)


class SimulatedDepthCamera:
    """`pcmrs.scene.depth_frame.DepthCamera` with a model of the cell whose arm stands as the real one.

    Args:
        facts: Facts of the arm.
        flange_from_tool: Pose of the tool on the flange.
        phantom: The body, its pose, and the tool.
        joints: Returns the newest joints of the arm, rad; None if they are not known.
        base_from_camera: Pose of the camera.
        rate_hz: Rate of the images, Hz.
        clock: Clock of the machine.
        seed: Seed of the noise.

    Attributes:
        intrinsics: Pinhole model of the camera.
        hand: Position of the hand in the robot's base, m; None while it is away.
        occluded: True if something is right before the lens.
        frozen: True if the last image is repeated.
        moved: Distance by which the camera was pushed back, m.
    """

    intrinsics = INTRINSICS

    def __init__(
        self,
        facts: ArmFacts,
        flange_from_tool: Transform,
        phantom: Phantom,
        joints: Callable[[], Floats | None],
        base_from_camera: Transform,
        rate_hz: float,
        clock: Clock,
        seed: int = 0,
    ) -> None:
        self.hand: tuple[float, float, float] | None = None
        self.occluded = self.frozen = False
        self.moved = 0.0
        self._model = scene_model(facts, flange_from_tool, phantom)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = facts.home
        self._base_from_camera = base_from_camera
        self._imager = DepthImager(self._model, self._data, INTRINSICS, base_from_camera)
        self._pushed = (0.0, self._imager)
        self._joints = joints
        self._clock = clock
        self._period = 1.0 / rate_hz
        self._rng = np.random.default_rng(seed)
        self._last: DepthFrame | None = None

    def close(self) -> None:
        """Do nothing: nothing is open."""

    async def frames(self) -> AsyncIterator[DepthFrame]:
        """Yield images at the rate, or as fast as they can be computed; never end."""
        due = self._clock.monotonic()
        while True:
            await self._clock.sleep(max(0.0, due - self._clock.monotonic()))
            due = max(due + self._period, self._clock.monotonic())
            yield await asyncio.to_thread(self.look)

    def look(self) -> DepthFrame:
        """Return an image of the present scene; a frozen camera returns its last one."""
        if self.frozen and self._last is not None:
            return self._last
        captured = self._clock.monotonic()
        joints = self._joints()
        if joints is not None:
            self._data.qpos[:] = joints
        self._data.mocap_pos[0] = AWAY if self.hand is None else self.hand
        mujoco.mj_kinematics(self._model, self._data)
        depth = self._view().image()
        noise = self._rng.normal(0.0, NOISE, depth.shape) * depth**2
        depth = np.where(depth > 0.0, depth + noise, 0.0).astype(np.float32)
        if self.occluded:
            depth[:] = 0.0  # nearer than the camera can measure
        self._last = DepthFrame(0 if self._last is None else self._last.number + 1, captured, depth)
        return self._last

    def _view(self) -> DepthImager:
        if self._pushed[0] != self.moved:
            back = Transform.from_rotvec((0.0, 0.0, -self.moved), (0.0, 0.0, 0.0))
            pose = self._base_from_camera @ back
            self._pushed = (self.moved, DepthImager(self._model, self._data, INTRINSICS, pose))
        return self._pushed[1]


def scene_model(facts: ArmFacts, flange_from_tool: Transform, phantom: Phantom) -> Any:
    """Return arm, tool, body, bench, floor and a hand that can be placed anywhere, as an ``mujoco.MjModel``.

    Args:
        facts: Facts of the arm.
        flange_from_tool: Pose of the tool on the flange.
        phantom: The body, its pose, and the tool.
    """
    spec = mujoco.MjSpec.from_string(mjcf(facts))
    flange = spec.site("flange")
    link_from_tool = Transform.from_quat_wxyz(flange.pos, flange.quat) @ flange_from_tool
    tool = flange.parent.add_body(name="tool", pos=link_from_tool.translation, quat=link_from_tool.quat_wxyz)
    _add(tool, phantom.tool)
    world = spec.worldbody
    vertices, faces = SURFACES[phantom]()
    spec.add_mesh(name="body", uservert=vertices.ravel(), userface=faces.ravel())
    pose = phantom.world_from_image
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="body",
        pos=pose.translation,
        quat=pose.quat_wxyz,
        contype=0,  # without contacts the compiler needs no convex hull
        conaffinity=0,
    )
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=BENCH[0], size=BENCH[1])
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, pos=(0.0, 0.0, FLOOR), size=(5.0, 5.0, 0.1))
    hand = world.add_body(name="hand", mocap=True, pos=AWAY)
    (palm_radius, palm), (arm_radius, forearm) = HAND
    hand.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(palm_radius, palm, 0.0))
    hand.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(arm_radius, forearm, 0.0), pos=(0.0, 0.0, palm + forearm))
    return spec.compile()


def _add(body: Any, shapes: Sequence[Shape]) -> None:
    for shape in shapes:
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
            pos=shape.pose.translation,
            quat=shape.pose.quat_wxyz,
            size=[*shape.size, 0.0, 0.0][:3],
            mass=max(shape.mass, 1e-3),
        )


def open_simulated(
    settings: Mapping[str, Any], joints: Callable[[], Floats | None], base_from_camera: Transform, rate_hz: float
) -> SimulatedDepthCamera:
    """Return the camera of a simulated cell.

    Args:
        settings: The whole configuration as plain data; ``sim`` and ``robot`` are read.
        joints: Returns the newest joints of the arm, rad; None if they are not known.
        base_from_camera: Pose of the camera.
        rate_hz: Rate of the images, Hz.

    Raises:
        ConfigurationError: The arm is unknown, or the table ``sim`` is wrong.
    """
    own = read_settings(settings)
    return SimulatedDepthCamera(
        find_arm(settings["robot"]["model"]),
        own.geometry.flange_from_tool_tip.transform,
        PHANTOMS[own.phantom],
        joints,
        base_from_camera,
        rate_hz,
        SystemClock(),
        own.seed,
    )
