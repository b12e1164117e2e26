"""Arms as tables of facts, from which every model of an arm is made.

Lengths, joint limits, speeds and torques are from KUKA's data sheets. KUKA publishes no inertias: masses, centres of
mass and inertias are the approximations in common use in the research community. They are good enough to simulate the
arm and to compensate gravity roughly, but they are not identified values.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians

from pcmrs.spatial import Transform

__all__ = ["ARMS", "IIWA7_R800", "IIWA14_R820", "ArmFacts", "JointFacts"]

Triple = tuple[float, float, float]
Inertia = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class JointFacts:
    """One revolute joint about the z axis of its frame, and the link that it moves.

    Attributes:
        name: Name of the joint, unique in the arm.
        xyz: Origin of the joint frame in the frame of the previous joint, m.
        rpy: Orientation of the joint frame in the frame of the previous joint: fixed-axis roll, pitch, yaw, rad, as in
            URDF.
        lower: Lowest position, rad.
        upper: Highest position, rad.
        velocity: Greatest speed, rad/s.
        effort: Greatest torque, N m.
        mass: Mass of the link, kg.
        com: Centre of mass of the link in the joint frame, m.
        inertia: Inertia of the link about its centre of mass, along the axes of the joint frame: ixx iyy izz ixy ixz
            iyz, kg m^2.
    """

    name: str
    xyz: Triple
    rpy: Triple
    lower: float
    upper: float
    velocity: float
    effort: float
    mass: float
    com: Triple
    inertia: Inertia

    @property
    def parent_from_joint(self) -> Transform:
        """Pose of the joint frame at joint position 0 in the frame of the previous joint."""
        return _pose(self.xyz, self.rpy)


@dataclass(frozen=True)
class ArmFacts:
    """A serial arm of revolute joints whose base is fixed.

    Attributes:
        name: Name of the arm, as in `ARMS`.
        joints: Joints from the base to the flange, (n,).
        flange_xyz: Origin of the flange in the frame of the last joint, m.
        home: Posture in which the arm waits, clear of a body in front of it, rad, (n,).
        stiffness: Joint stiffness of the simulated arm's impedance controller, N m/rad, (n,).
        flange_rpy: Orientation of the flange in the frame of the last joint: fixed-axis roll, pitch, yaw, rad.
        link_radius: Radius of all links as capsules from joint to joint, m. Wrist links of the real arm are slimmer.
    """

    name: str
    joints: tuple[JointFacts, ...]
    flange_xyz: Triple
    home: tuple[float, ...]
    stiffness: tuple[float, ...]
    flange_rpy: Triple = (0.0, 0.0, 0.0)
    link_radius: float = 0.06

    @property
    def joint_from_flange(self) -> Transform:
        """Pose of the flange in the frame of the last joint."""
        return _pose(self.flange_xyz, self.flange_rpy)


def _pose(xyz: Triple, rpy: Triple) -> Transform:
    return Transform.from_zyx(xyz, rpy[::-1])


# In the zero posture the arm stands upright. Its joint axes are then z, y, z, -y, z, y, z of the base.
_RPY = (
    (0.0, 0.0, 0.0),
    (pi / 2, 0.0, pi),
    (pi / 2, 0.0, pi),
    (pi / 2, 0.0, 0.0),
    (-pi / 2, pi, 0.0),
    (pi / 2, 0.0, 0.0),
    (-pi / 2, pi, 0.0),
)
_HOME = (0.0, -0.35, 0.0, -1.57, 0.0, 1.40, -1.57)
_STIFFNESS = (4000.0, 4000.0, 3000.0, 3000.0, 2000.0, 2000.0, 1500.0)
_LIMIT_DEG = (170, 120, 170, 120, 170, 120, 175)


def _joint(
    number: int, xyz: Triple, speed_deg: float, effort: float, mass: float, com: Triple, inertia: Inertia
) -> JointFacts:
    limit = radians(_LIMIT_DEG[number - 1])
    rpy = _RPY[number - 1]
    return JointFacts(f"joint_{number}", xyz, rpy, -limit, limit, radians(speed_deg), effort, mass, com, inertia)


# number, xyz m, speed deg/s, torque N m, mass kg, centre of mass m, inertia kg m^2
IIWA14_R820 = ArmFacts(
    "iiwa14",
    (
        _joint(1, (0, 0, 0.1575), 85, 320, 5.76, (0, -0.03, 0.12), (0.033, 0.0333, 0.0123, 0, 0, 0)),
        _joint(2, (0, 0, 0.2025), 85, 320, 6.35, (0.0003, 0.059, 0.042), (0.0305, 0.0304, 0.011, 0, 0, 0)),
        _joint(3, (0, 0.2045, 0), 100, 176, 3.5, (0, 0.03, 0.13), (0.025, 0.0238, 0.0076, 0, 0, 0)),
        _joint(4, (0, 0, 0.2155), 75, 176, 3.5, (0, 0.067, 0.034), (0.017, 0.0164, 0.006, 0, 0, 0)),
        _joint(5, (0, 0.1845, 0), 130, 110, 3.5, (0.0001, 0.021, 0.076), (0.01, 0.0087, 0.00449, 0, 0, 0)),
        _joint(6, (0, 0, 0.2155), 135, 40, 1.8, (0, 0.0006, 0.0004), (0.0049, 0.0047, 0.0036, 0, 0, 0)),
        _joint(7, (0, 0.081, 0), 135, 40, 1.2, (0, 0, 0.02), (0.001, 0.001, 0.001, 0, 0, 0)),
    ),
    flange_xyz=(0, 0, 0.045),
    home=_HOME,
    stiffness=_STIFFNESS,
)
"""KUKA LBR iiwa 14 R820."""

IIWA7_R800 = ArmFacts(
    "iiwa7",
    (
        _joint(1, (0, 0, 0.15), 98, 176, 3.45, (0, -0.03, 0.12), (0.0218, 0.0208, 0.0077, 0, 0, 0)),
        _joint(2, (0, 0, 0.19), 98, 176, 3.48, (0.0003, 0.059, 0.042), (0.0218, 0.0208, 0.0078, 0, 0, 0)),
        _joint(3, (0, 0.21, 0), 100, 110, 4.06, (0, 0.03, 0.13), (0.032, 0.0304, 0.0097, 0, 0, 0)),
        _joint(4, (0, 0, 0.19), 130, 110, 3.48, (0, 0.067, 0.034), (0.0218, 0.0208, 0.0078, 0, 0, 0)),
        _joint(5, (0, 0.21, 0), 140, 110, 2.16, (0.0001, 0.021, 0.076), (0.0129, 0.0111, 0.0057, 0, 0, 0)),
        _joint(6, (0, 0, 0.19), 180, 40, 2.35, (0, 0.0006, 0.0004), (0.0065, 0.0063, 0.0045, 0, 0, 0)),
        _joint(7, (0, 0.081, 0), 180, 40, 1.2, (0, 0, 0.02), (0.001, 0.001, 0.001, 0, 0, 0)),
    ),
    flange_xyz=(0, 0, 0.045),
    home=_HOME,
    stiffness=_STIFFNESS,
)
"""KUKA LBR iiwa 7 R800."""

ARMS = {facts.name: facts for facts in (IIWA14_R820, IIWA7_R800)}
"""The known arms by name."""
