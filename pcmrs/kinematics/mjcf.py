"""MJCF of an arm for MuJoCo, written from its facts; a scene attaches or merges it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import hypot
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from pcmrs.kinematics.arms import ArmFacts, JointFacts

__all__ = ["mjcf"]

_NO_LENGTH = 1e-6  # m


def mjcf(facts: ArmFacts, *, damping: float = 0.5, armature: float = 0.1, frictionloss: float = 0.3) -> str:
    """Return the arm as an MJCF document: a chain of bodies, torque motors and a site named ``flange``.

    Bodies are ``base`` and ``link_<number>``; joints and their motors have the names of the facts; a motor's
    control is the joint torque in N m. Links are capsules that touch the scene but not each other.

    Args:
        facts: Facts of the arm.
        damping: Viscous friction of every joint, N m s/rad.
        armature: Rotor inertia of every joint, seen through its gear, kg m^2.
        frictionloss: Dry friction of every joint, N m.
    """
    root = Element("mujoco", model=facts.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    body = SubElement(SubElement(root, "worldbody"), "body", name="base")
    offsets = [joint.xyz for joint in facts.joints] + [facts.flange_xyz]
    _add_capsule(body, offsets[0], facts.link_radius)
    actuators = SubElement(root, "actuator")
    friction = {"damping": repr(damping), "armature": repr(armature), "frictionloss": repr(frictionloss)}
    for number, joint in enumerate(facts.joints, start=1):
        body = _add_link(body, f"link_{number}", joint, friction)
        _add_capsule(body, offsets[number], facts.link_radius)
        SubElement(
            actuators, "motor", name=joint.name, joint=joint.name, ctrlrange=_text((-joint.effort, joint.effort))
        )
    flange_quat = facts.joint_from_flange.quat_wxyz.tolist()
    SubElement(body, "site", name="flange", pos=_text(facts.flange_xyz), quat=_text(flange_quat))
    indent(root)
    return tostring(root, encoding="unicode")


def _add_link(parent: Element, name: str, joint: JointFacts, friction: dict[str, str]) -> Element:
    quat = joint.parent_from_joint.quat_wxyz.tolist()
    body = SubElement(parent, "body", name=name, pos=_text(joint.xyz), quat=_text(quat))
    inertia = {"mass": repr(joint.mass), "pos": _text(joint.com), "fullinertia": _text(joint.inertia)}
    SubElement(body, "inertial", inertia)
    limits = _text((joint.lower, joint.upper))
    SubElement(body, "joint", {"name": joint.name, "axis": "0 0 1", "range": limits, **friction})
    return body


def _add_capsule(body: Element, end: Sequence[float], radius: float) -> None:
    """Add a capsule from the body's origin to the next joint. It collides with other shapes, but not with other links.

    Nothing is added if the next joint is at the same place.
    """
    if hypot(*end) < _NO_LENGTH:
        return
    shape = {"type": "capsule", "size": repr(radius), "fromto": _text((0.0, 0.0, 0.0, *end))}
    # Two shapes collide if the type of one matches the affinity of the other. Links have no affinity, so they never
    # collide with each other.
    SubElement(body, "geom", {**shape, "contype": "1", "conaffinity": "0"})


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(value) for value in values)
