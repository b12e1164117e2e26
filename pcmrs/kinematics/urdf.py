"""URDF of an arm for Pinocchio and other readers, written from its facts."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from pcmrs.kinematics.arms import ArmFacts, JointFacts

__all__ = ["urdf"]


def urdf(facts: ArmFacts) -> str:
    """Return the arm as a URDF document without geometry.

    Links: ``base``, one named ``link_<number>`` per joint, and ``flange`` on a fixed joint.
    """
    robot = Element("robot", name=facts.name)
    SubElement(robot, "link", name="base")
    parent = "base"
    for number, joint in enumerate(facts.joints, start=1):
        child = f"link_{number}"
        _add_link(robot, child, joint)
        _add_joint(robot, joint, parent, child)
        parent = child
    SubElement(robot, "link", name="flange")
    fixed = SubElement(robot, "joint", name="flange_mount", type="fixed")
    SubElement(fixed, "parent", link=parent)
    SubElement(fixed, "child", link="flange")
    SubElement(fixed, "origin", xyz=_text(facts.flange_xyz), rpy=_text(facts.flange_rpy))
    indent(robot)
    return tostring(robot, encoding="unicode")


def _add_link(robot: Element, name: str, joint: JointFacts) -> None:
    inertial = SubElement(SubElement(robot, "link", name=name), "inertial")
    SubElement(inertial, "origin", xyz=_text(joint.com), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(joint.mass))
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    SubElement(inertial, "inertia", {name: repr(value) for name, value in zip(names, joint.inertia, strict=True)})


def _add_joint(robot: Element, joint: JointFacts, parent: str, child: str) -> None:
    element = SubElement(robot, "joint", name=joint.name, type="revolute")
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)
    SubElement(element, "origin", xyz=_text(joint.xyz), rpy=_text(joint.rpy))
    SubElement(element, "axis", xyz="0 0 1")
    limits = {"lower": joint.lower, "upper": joint.upper, "velocity": joint.velocity, "effort": joint.effort}
    SubElement(element, "limit", {name: repr(value) for name, value in limits.items()})


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(value) for value in values)
