"""The links and joints of a URDF document, with their numbers checked."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.body import Body
from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint as its document states it.

    Attributes:
        name: Unique in the document.
        kind: ``revolute``, ``fixed``, ``prismatic``, …
        parent: The link that carries it.
        child: The link that it moves.
        parent_from_joint: Its frame, which is that of the child at joint position 0.
        axis: Unit vector in its frame, (3,).
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
        name: How errors call it.

    Attributes:
        links: By name.

    Raises:
        ConfigurationError: It is no URDF, or holds a number that is none.
    """

    def __init__(self, text: str, name: str) -> None:
        self._name = name
        try:
            root = fromstring(text)  # noqa: S314  # Expat bounds how much entities grow
        except ParseError as error:
            raise self.error(f"it is no XML: {error}", "check the file") from None
        self.links = {link.get("name", ""): link for link in root.findall("link")}
        self._elements = {joint.get("name", ""): joint for joint in root.findall("joint")}
        self._joints = [self._joint(name, element) for name, element in self._elements.items()]

    def error(self, what: str, advice: str) -> ConfigurationError:
        """An error that says what is wrong with this arm, and what to do."""
        return ConfigurationError(f"The arm {self._name!r} cannot be used: {what}; {advice}.", model=self._name)

    def joints_on(self, link: str) -> list[UrdfJoint]:
        """The joints that a link carries."""
        return [joint for joint in self._joints if joint.parent == link]

    def chain(self, tip: str) -> list[UrdfJoint]:
        """The joints from the root to a link."""
        if tip not in self.links:
            raise self.error(f"it has no link {tip}", f"it has {', '.join(self.links)}")
        carrying = {joint.child: joint for joint in self._joints}
        chain: list[UrdfJoint] = []
        while tip in carrying:
            chain.insert(0, carrying.pop(tip))  # popped, so that a circle ends
            tip = chain[0].parent
        return chain

    def limits(self, joint: UrdfJoint) -> tuple[float, float, float, float]:
        """Lowest and highest position (rad), greatest speed (rad/s) and torque (N m) of a joint."""
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

    def bodies_on(self, link: str, stops: Collection[str]) -> Iterator[Body]:
        """The bodies of a link and of all that is joined to it, joints at 0, in the link's frame.

        Args:
            link: Where to begin.
            stops: Names of joints beyond which nothing belongs to it.
        """
        yield from self._own_body(link)
        for joint in self.joints_on(link):
            if joint.name not in stops:
                for body in self.bodies_on(joint.child, stops):
                    yield body.seen_from(joint.parent_from_joint)

    def _own_body(self, link: str) -> Iterator[Body]:
        element = self.links[link].find("inertial") if link in self.links else None
        if element is None:
            return
        inertia, mass = element.find("inertia"), element.find("mass")
        xx, yy, zz, xy, xz, yz = (
            float(self._numbers(inertia, key, "0", link)[0]) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        own = Body(
            float(self._numbers(mass, "value", "0", link)[0]),
            np.zeros(3),
            np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))),
        )
        yield own.seen_from(self._pose(element, link))

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
