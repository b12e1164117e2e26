"""Links and joints of a URDF document with their numbers checked, and the mass properties of its links."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from pcmrs.errors import ConfigurationError
from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of a rigid body in some frame.

    Attributes:
        mass: Mass, kg.
        com: Centre of mass in the frame, m, (3,).
        inertia: Inertia about the centre of mass, along the axes of the frame, kg m^2, (3, 3).
    """

    mass: float
    com: Floats
    inertia: Floats

    def expressed_in(self, frame_from_own: Transform) -> MassProperties:
        """Return the mass properties in another frame, given the pose of the present one in it."""
        turn = frame_from_own.rotation
        return MassProperties(self.mass, frame_from_own @ self.com, turn @ self.inertia @ turn.T)


def merge_bodies(bodies: Sequence[MassProperties]) -> MassProperties:
    """Return bodies that are fixed to each other as one body, by the parallel axis theorem.

    All bodies are in one frame, and their total mass must be positive.
    """
    mass = sum(body.mass for body in bodies)
    com = sum((body.mass * body.com for body in bodies), np.zeros(3)) / mass
    inertia = sum((body.inertia + _of_point(body.mass, body.com - com) for body in bodies), np.zeros((3, 3)))
    return MassProperties(mass, com, inertia)


def _of_point(mass: float, offset: Floats) -> Floats:
    """Return the inertia of a point mass at an offset (3,), m, about the origin, kg m^2, (3, 3)."""
    inertia: Floats = mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return inertia


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint as its document states it.

    Attributes:
        name: Name of the joint, unique in the document.
        kind: ``revolute``, ``fixed``, ``prismatic``, …
        parent: Link that carries the joint.
        child: Link that the joint moves.
        parent_from_joint: Pose of the joint frame in the parent; at joint position 0 it is the frame of the child.
        axis: Unit vector of the joint's axis in the joint frame, (3,).
    """

    name: str
    kind: str
    parent: str
    child: str
    parent_from_joint: Transform
    axis: Floats


class UrdfTree:
    """A URDF document.

    Args:
        text: The document.
        name: Name of the arm in error messages.

    Attributes:
        links: Link elements by name.

    Raises:
        ConfigurationError: The document is not URDF, or a number in it is malformed.
    """

    def __init__(self, text: str, name: str) -> None:
        self._name = name
        try:
            root = fromstring(text)  # noqa: S314  # Expat bounds how much entities grow
        except ParseError as error:
            raise self.error(f"it is not XML: {error}", "check the file") from None
        self.links = {link.get("name", ""): link for link in root.findall("link")}
        self._elements = {joint.get("name", ""): joint for joint in root.findall("joint")}
        self._joints = [self._joint(name, element) for name, element in self._elements.items()]

    def error(self, what: str, advice: str) -> ConfigurationError:
        """Return an error that says what is wrong with this arm and what to do.

        Args:
            what: The defect, as a clause.
            advice: The remedy, as an imperative.
        """
        return ConfigurationError(f"The arm {self._name!r} cannot be used: {what}; {advice}.", model=self._name)

    def joints_on(self, link: str) -> list[UrdfJoint]:
        """Return the joints that a link carries."""
        return [joint for joint in self._joints if joint.parent == link]

    def chain(self, tip: str) -> list[UrdfJoint]:
        """Return the joints from the root to a link."""
        if tip not in self.links:
            raise self.error(f"it has no link {tip}", f"it has {', '.join(self.links)}")
        carrying = {joint.child: joint for joint in self._joints}
        chain: list[UrdfJoint] = []
        while tip in carrying:
            chain.insert(0, carrying.pop(tip))  # popped, so that the loop ends even if the links form a cycle
            tip = chain[0].parent
        return chain

    def limits(self, joint: UrdfJoint) -> tuple[float, float, float, float]:
        """Return the lowest and highest position (rad), greatest speed (rad/s) and greatest torque (N m) of a joint."""
        limit = self._elements[joint.name].find("limit")
        missing = [key for key in ("lower", "upper", "velocity", "effort") if limit is None or key not in limit.attrib]
        if missing:
            raise self.error(f"the joint {joint.name} has no limit {', '.join(missing)}", "add what is missing")
        lower, upper, velocity, effort = (
            float(self._numbers(limit, key, "", joint.name)[0]) for key in ("lower", "upper", "velocity", "effort")
        )
        if not (lower < upper and velocity > 0.0 and effort > 0.0):
            text = f"lower {lower:g}, upper {upper:g}, velocity {velocity:g}, effort {effort:g}"
            raise self.error(f"the limits of the joint {joint.name} leave it no motion ({text})", "correct them")
        return lower, upper, velocity, effort

    def bodies_on(self, link: str, stops: Collection[str]) -> Iterator[MassProperties]:
        """Yield the bodies of a link and of everything joined to it with all joints at 0, in the link's frame.

        Args:
            link: Link to start from.
            stops: Names of the joints that end the search; links beyond them are left out.

        Raises:
            ConfigurationError: The joints form a circle.
        """
        yield from self._bodies_beyond(link, stops, ())

    def _bodies_beyond(self, link: str, stops: Collection[str], path: tuple[str, ...]) -> Iterator[MassProperties]:
        if link in path:
            raise self.error(f"the joints from {link} lead back to {link}", "remove one of them")
        yield from self._own_body(link)
        for joint in self.joints_on(link):
            if joint.name not in stops:
                for body in self._bodies_beyond(joint.child, stops, (*path, link)):
                    yield body.expressed_in(joint.parent_from_joint)

    def _own_body(self, link: str) -> Iterator[MassProperties]:
        """Yield the body of a link in its own frame, or nothing if the link has no inertial element."""
        element = self.links[link].find("inertial") if link in self.links else None
        if element is None:
            return
        inertia, mass = element.find("inertia"), element.find("mass")
        xx, yy, zz, xy, xz, yz = (
            float(self._numbers(inertia, key, "0", link)[0]) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        own = MassProperties(
            float(self._numbers(mass, "value", "0", link)[0]),
            np.zeros(3),
            np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))),
        )
        yield own.expressed_in(self._pose(element, link))

    def _joint(self, name: str, element: Element) -> UrdfJoint:
        parent, child = (_link(element, key) for key in ("parent", "child"))
        axis = self._numbers(element.find("axis"), "xyz", "1 0 0", name, 3)
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise self.error(f"the axis of the joint {name} has no direction", "correct it")
        return UrdfJoint(name, element.get("type", ""), parent, child, self._pose(element, name), axis / length)

    def _pose(self, element: Element, where: str) -> Transform:
        origin = element.find("origin")
        rpy = self._numbers(origin, "rpy", "0 0 0", where, 3)
        xyz = self._numbers(origin, "xyz", "0 0 0", where, 3)
        return Transform.from_zyx(xyz, rpy[::-1])

    def _numbers(self, element: Element | None, key: str, default: str, where: str, count: int = 1) -> Floats:
        text = default if element is None else element.get(key, default)
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            numbers = np.empty(0)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            raise self.error(f"{where} says {key}={text!r}", f"{count} finite numbers are needed")
        return numbers


def _link(joint: Element, key: str) -> str:
    element = joint.find(key)
    return "" if element is None else element.get("link", "")
