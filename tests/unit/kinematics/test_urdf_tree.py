"""Links and joints of a URDF document: what is missing or wrong is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics._urdf_reader import read_urdf
from pcmrs.kinematics._urdf_tree import MassProperties, UrdfTree, merge_bodies
from pcmrs.spatial import Floats, Transform
from tests.unit.kinematics.urdf_documents import ARM


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('<limit lower="-2" upper="2" velocity="2" effort="20"/>', "", "second has no limit lower, upper"),
        (' velocity="1" effort="50"', ' effort="50"', "first has no limit velocity"),
        ('lower="-2" upper="2"', 'lower="2" upper="2"', "second leave it no motion"),
        ('velocity="2"', 'velocity="inf"', "second says velocity='inf'"),
        ('name="second" type="revolute"', 'name="second" type="continuous"', "second is continuous"),
        ('<mass value="1"/>', '<mass value="0"/>', "second moves a link without mass"),
        ('<axis xyz="0 0 -1"/>', '<axis xyz="0 0 0"/>', "axis of the joint second"),
        ('xyz="0.3 0 0"', 'xyz="0.3 0"', "3 finite numbers"),
        ('<link name="tool0"/>', "", "ends lid"),
        ("</robot>", "", "not XML"),
    ],
)
def test_missing_item_is_named(old: str, new: str, text: str) -> None:
    assert old in ARM
    with pytest.raises(ConfigurationError, match=text):
        read_urdf(ARM.replace(old, new), "odd")


def test_circle_of_joints_beside_the_chain_is_refused() -> None:
    circle = '<joint name="loop" type="fixed"><parent link="lid"/><child link="box"/></joint></robot>'
    with pytest.raises(ConfigurationError, match="lead back to box"):
        read_urdf(ARM.replace("</robot>", circle), "odd")


def energy(bodies: list[tuple[float, Floats]], turn: Floats) -> float:
    """Return the kinetic energy of point masses, kg, at places, m, that turn about the origin, rad/s."""
    return sum(0.5 * mass * float(np.sum(np.cross(turn, place) ** 2)) for mass, place in bodies)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_merged_bodies_move_as_their_points_do(seed: int, count: int) -> None:
    """Three masses on the axes of each body have its inertia; a rotation about any axis gives them their energy."""
    rng = np.random.default_rng(seed)
    points: list[tuple[float, Floats]] = []
    bodies = []
    for _ in range(count):
        pose = Transform.from_rotvec(rng.uniform(-1.0, 1.0, 3), rng.uniform(-3.0, 3.0, 3))
        masses, arms = rng.uniform(0.1, 2.0, 3), rng.uniform(0.1, 0.5, 3)
        own = [(float(m / 2.0), sign * arm * axis) for m, arm, axis in zip(masses, arms, np.eye(3), strict=True)
               for sign in (1.0, -1.0)]  # fmt: skip
        inertia = np.diag([sum(m * (p @ p - p[k] ** 2) for m, p in own) for k in range(3)])
        bodies.append(MassProperties(float(masses.sum()), np.zeros(3), inertia).expressed_in(pose))
        points += [(m, pose @ p) for m, p in own]
    whole = merge_bodies(bodies)
    assert whole.mass == pytest.approx(sum(mass for mass, _ in points))
    np.testing.assert_allclose(whole.com, sum(mass * place for mass, place in points) / whole.mass, atol=1e-12)
    turn = rng.uniform(-2.0, 2.0, 3)
    about_com = 0.5 * float(turn @ whole.inertia @ turn)
    assert energy([*points], turn) == pytest.approx(about_com + energy([(whole.mass, whole.com)], turn))


def test_the_chain_to_a_link_starts_at_the_root() -> None:
    tree = UrdfTree(ARM, "odd")
    assert [joint.name for joint in tree.chain("tool0")] == ["stand", "first", "second", "mount"]
    assert tree.chain("world") == []
    assert {joint.name for joint in tree.joints_on("one")} == {"glued", "second"}
    assert [joint.axis.tolist() for joint in tree.chain("tool0")[1:3]] == [
        pytest.approx([1 / 3, 2 / 3, -2 / 3]),
        [0.0, 0.0, -1.0],
    ]


def test_links_in_a_circle_end_the_chain() -> None:
    tree = UrdfTree(ARM.replace('<parent link="world"/>', '<parent link="two"/>'), "odd")
    assert sorted(joint.name for joint in tree.chain("two")) == ["first", "second", "stand"]


def test_bodies_beyond_a_joint_that_stops_are_left_out() -> None:
    tree = UrdfTree(ARM, "odd")
    assert sorted(body.mass for body in tree.bodies_on("one", {"second"})) == [0.2, 0.5, 2.0]
    assert sorted(body.mass for body in tree.bodies_on("one", {"second", "glued"})) == [2.0]
    lid = next(body for body in tree.bodies_on("one", {"second"}) if body.mass == 0.2)
    glued = Transform.from_rotvec((0.0, 0.1, 0.1), (1.0, 0.0, 0.0))
    np.testing.assert_allclose(lid.com, glued @ np.array((0.0, 0.0, 0.1)))
