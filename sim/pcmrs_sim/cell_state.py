"""Where the bodies of the simulated cell are, and which marker spheres the tracker sees, by its MuJoCo model."""

from __future__ import annotations

from copy import copy
from functools import lru_cache
from math import cos, radians
from typing import Any, NamedTuple

import msgspec
import mujoco
import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.cell_model import OPAQUE, cell_model, sensor_addresses
from pcmrs_sim.error_models import displaced
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.settings import SimSettings, TrackerSettings

WIDEST_ANGLE = radians(85.0)
"""Largest angle between the normal of a sphere and its line of sight, rad: beyond it, its post and plate cover it."""
SKIN_DEPTH = 1e-4
"""Depth of a sphere's centre behind a surface that counts as free, m, because rays are exact to less than that."""

Mask = npt.NDArray[np.bool_]


class Sight(NamedTuple):
    """The spheres of a marker body as the tracker finds them.

    Attributes:
        inside: Mask of the spheres in the measuring volume, (K,).
        seen: Mask of those among them that nothing hides, (K,).
    """

    inside: Mask
    seen: Mask


class CellState:
    """The model of the cell with the present places of its bodies.

    Reading a pose never changes a motion: the dynamics of the arm use separate data of the model.

    Args:
        facts: Nominal geometry and inertias of the arm, whose true joints are displaced by the seed of the settings.
        settings: Settings of the cell.
        phantom: The patient, and the tool.

    Attributes:
        model: The cell, an ``mujoco.MjModel``.
        data: Its state, an ``mujoco.MjData``; up to date after `refresh`.
    """

    def __init__(self, facts: ArmFacts, settings: SimSettings, phantom: Phantom) -> None:
        # Copied, because the compiler takes 15 ms, and explored sessions open thousands of cells with other seeds.
        self.model = model = copy(_compiled(facts, msgspec.structs.replace(settings, seed=0), phantom))
        _displace(model, facts, displaced(facts, settings.arm.geometry_error_mm * 1e-3, settings.seed))
        self.data = mujoco.MjData(model)
        self._addresses = sensor_addresses(model)
        self._mocap = {body: int(model.body(body).mocapid[0]) for body in ("body", "pointer")}
        self._rays = _Rays(model, settings.tracker)
        self._poses: dict[str, tuple[bytes, Transform]] = {}
        self._sights: dict[str, Sight] | None = None
        self._stale = True
        self._first_link = model.body("link_1").pos.copy()
        self.place("body", phantom.world_from_image)

    def move_joints(self, positions: Floats) -> None:
        """Set the posture of the arm, rad, (n,)."""
        if not np.array_equal(positions, self.data.qpos):
            self.data.qpos[:] = positions
            self._stale = True

    def displace_arm(self, offset: Floats) -> None:
        """Displace the whole arm from where its joints put it, m, (3,) in the world."""
        self.model.body("link_1").pos = self._first_link + offset
        self._stale = True

    def place(self, body: str, world_from_body: Transform) -> None:
        """Move a body.

        Args:
            body: ``body`` for the patient, or ``pointer``.
            world_from_body: Its new pose.
        """
        mocap = self._mocap[body]
        self.data.mocap_pos[mocap], self.data.mocap_quat[mocap] = world_from_body.translation, world_from_body.quat_wxyz
        self._stale = True

    def fix(self, body: str, image_from_body: Transform) -> None:
        """Fix a marker body to the patient.

        Args:
            body: ``body_ref`` or ``witness``.
            image_from_body: Its pose on the patient.
        """
        number = self.model.body(body).id
        self.model.body_pos[number], self.model.body_quat[number] = (
            image_from_body.translation,
            image_from_body.quat_wxyz,
        )
        self._stale = True

    def pose(self, name: str) -> Transform:
        """Return a pose of `pcmrs_sim.cell_model.FRAMES`; the same object as long as the sensors read the same."""
        self.refresh()
        address = self._addresses[name]
        reading = self.data.sensordata[address : address + 7]
        as_bytes, known = reading.tobytes(), self._poses.get(name)
        if known is None or known[0] != as_bytes:
            known = self._poses[name] = as_bytes, Transform.from_quat_wxyz(reading[:3], reading[3:])
        return known[1]

    def sight(self, body: str) -> Sight:
        """Return which spheres of a marker body the tracker sees."""
        self.refresh()
        if self._sights is None:
            self._sights = self._rays.cast(self.data)
        return self._sights[body]

    def refresh(self) -> None:
        """Compute the state, if anything was moved."""
        if self._stale:
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_camlight(self.model, self.data)
            mujoco.mj_sensorPos(self.model, self.data)
            self._stale, self._sights = False, None


@lru_cache(maxsize=8)
def _compiled(facts: ArmFacts, settings: SimSettings, phantom: Phantom) -> Any:
    return cell_model(facts, settings, phantom)


def _displace(model: Any, nominal: ArmFacts, true: ArmFacts) -> None:
    """Move joints and flange of the model of a nominal arm to where they truly are."""
    for number, joint in enumerate(true.joints, start=1):
        model.body(f"link_{number}").pos = joint.xyz
    offset = np.subtract(true.flange_xyz, nominal.flange_xyz)
    model.site("flange").pos += offset
    model.body("tool").pos += offset
    mujoco.mj_setConst(model, mujoco.MjData(model))


class _Rays:
    """Casts a ray from the tracker to each marker sphere.

    Args:
        model: The cell, an ``mujoco.MjModel``.
        settings: The measuring volume.
    """

    def __init__(self, model: Any, settings: TrackerSettings) -> None:
        self._model, self._settings = model, settings
        self._tracker = model.site("tracker").id
        spheres = [(body, number) for body, each in MARKER_BODIES.items() for number in range(len(each.positions))]
        self._sites = np.array([model.site(f"{body}_{number}").id for body, number in spheres])
        self._of_body = {name: np.array([body == name for body, _ in spheres]) for name in MARKER_BODIES}
        self._groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        self._groups[OPAQUE] = 1

    def cast(self, data: Any) -> dict[str, Sight]:
        """Return what the tracker sees of each marker body.

        Args:
            data: State of the cell with its kinematics, an ``mujoco.MjData``.
        """
        eye, settings = data.site_xpos[self._tracker], self._settings
        ways = data.site_xpos[self._sites] - eye
        lengths = np.linalg.norm(ways, axis=1)
        x, y, z = (ways @ data.site_xmat[self._tracker].reshape(3, 3)).T
        half = settings.half_width * -z
        inside = (settings.nearest <= -z) & (-z <= settings.farthest) & (np.abs(x) <= half) & (np.abs(y) <= half)
        rays = ways / lengths[:, None]
        facing = -np.sum(rays * data.site_xmat[self._sites, 2::3], axis=1) > cos(WIDEST_ANGLE)
        seen = inside & facing & self._free(data, eye, rays, lengths)
        return {body: Sight(inside[mask], seen[mask]) for body, mask in self._of_body.items()}

    def _free(self, data: Any, eye: Floats, rays: Floats, lengths: Floats) -> Mask:
        """Return a mask of the rays, (N, 3), that meet nothing within their lengths, m, (N,)."""
        hits, geoms, count = np.zeros(len(rays)), np.zeros(len(rays), dtype=np.int32), len(rays)
        static, no_body = 1, -1
        mujoco.mj_multiRay(
            self._model, data, eye, rays.ravel(), self._groups, static, no_body, geoms, hits, None, count, lengths.max()
        )
        free: Mask = (hits < 0.0) | (hits > lengths - SKIN_DEPTH)
        return free
