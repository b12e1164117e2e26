"""Arms from URDF, with Pinocchio's reading of the same documents as the oracle."""

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import fromstring, tostring

import numpy as np
import pinocchio
import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics import urdf_arms
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.kinematics.urdf_reader import STIFFNESS, read_urdf

ARM = """
<robot name="odd">
  <link name="world"/>
  <link name="base"/>
  <link name="one"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial></link>
  <link name="box"><inertial><origin xyz="0 0.1 0" rpy="0.3 0.2 0.1"/><mass value="0.5"/>
    <inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lid"><inertial><mass value="0.2"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="two"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool0"/>
  <link name="gripper"><inertial><mass value="9"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="stand" type="fixed"><origin xyz="0 0 1" rpy="0 0 0.5"/><parent link="world"/><child link="base"/></joint>
  <joint name="first" type="revolute"><origin xyz="0.1 0.2 0.3" rpy="0.4 1.5707963267948966 0.6"/><parent link="base"/>
    <child link="one"/><axis xyz="1 2 -2"/><limit lower="-1" upper="2" velocity="1" effort="50"/></joint>
  <joint name="glued" type="fixed"><origin xyz="0 0.1 0.1" rpy="1 0 0"/><parent link="one"/><child link="box"/></joint>
  <joint name="hinge" type="prismatic"><origin xyz="0 0 0.1"/><parent link="box"/><child link="lid"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>
  <joint name="second" type="revolute"><origin xyz="0.3 0 0"/><parent link="one"/><child link="two"/>
    <axis xyz="0 0 -1"/><limit lower="-2" upper="2" velocity="2" effort="20"/></joint>
  <joint name="mount" type="fixed"><origin xyz="0 0.2 0" rpy="0 0.7 0"/><parent link="two"/>
    <child link="tool0"/></joint>
  <joint name="held" type="fixed"><parent link="tool0"/><child link="gripper"/></joint>
</robot>
"""


def without(text: str, *names: str) -> str:
    """The document without these links and joints."""
    root = fromstring(text)
    for element in list(root):
        if element.get("name") in names:
            root.remove(element)
    return tostring(root, encoding="unicode")


def assert_same_arm(text: str, tip: str, frozen: list[str], arm: ArmModel) -> None:
    """Kinematics and inverse dynamics as Pinocchio reads them from the document, some joints frozen at zero."""
    whole = pinocchio.buildModelFromXML(text)
    model = pinocchio.buildReducedModel(whole, [whole.getJointId(name) for name in frozen], pinocchio.neutral(whole))
    mine = pinocchio.buildModelFromXML(urdf(arm.facts))
    data = model.createData()
    rng = np.random.default_rng(9)
    for q in rng.uniform(arm.lower, arm.upper, (20, arm.joints)):
        pinocchio.framesForwardKinematics(model, data, q)
        pose = data.oMf[model.getFrameId(tip)]
        np.testing.assert_allclose(arm.forward(q).rotation, pose.rotation, atol=1e-9)
        np.testing.assert_allclose(arm.forward(q).translation, pose.translation, atol=1e-9)
        velocity, acceleration = rng.uniform(-3.0, 3.0, (2, arm.joints))
        torque = pinocchio.rnea(model, data, q, velocity, acceleration)
        np.testing.assert_allclose(
            pinocchio.rnea(mine, mine.createData(), q, velocity, acceleration), torque, atol=1e-9
        )


def test_an_odd_arm_is_the_one_that_pinocchio_reads() -> None:
    facts = read_urdf(ARM, "odd")
    assert [joint.name for joint in facts.joints] == ["first", "second"]
    assert facts.home == (0.5, 0.0)
    assert facts.stiffness == (STIFFNESS, STIFFNESS)
    assert_same_arm(without(ARM, "gripper", "held"), "tool0", ["hinge"], ArmModel(facts))


def test_only_end_link_carries_the_tool_if_none_is_named() -> None:
    """As in documents that end with the last link of the arm, and know no ``tool0``."""
    chain = without(ARM, "gripper", "held", "tool0", "mount", "lid", "hinge", "box", "glued")
    assert read_urdf(chain, "odd") == read_urdf(chain, "odd", flange="two")
    assert_same_arm(chain, "two", [], ArmModel(read_urdf(chain, "odd")))


HAND = [
    *("panda_hand", "panda_hand_tcp", "panda_leftfinger", "panda_rightfinger"),
    *("panda_hand_joint", "panda_hand_tcp_joint", "panda_finger_joint1", "panda_finger_joint2"),
]


@pytest.mark.parametrize(("name", "flange", "hand"), [("panda", "panda_link8", HAND), ("ur5", "tool0", [])])
def test_packaged_arms_are_those_that_pinocchio_reads(name: str, flange: str, hand: list[str]) -> None:
    path = next(
        path for path in files("example-robot-data") or [] if str(path).endswith(urdf_arms._PACKAGED[name].file)
    )
    arm = ArmModel(find_arm(name))
    assert arm.joints == {"panda": 7, "ur5": 6}[name]
    assert_same_arm(without(path.read_text(), *hand), flange, [], arm)


def test_a_file_is_read_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "mine.urdf"
    file.write_text(urdf(ARMS["iiwa14"]))
    facts = find_arm(str(file))
    assert facts.name == "mine"
    assert facts.home == (0.0,) * 7
    assert ArmModel(facts).spherical, "its inverse kinematics is in closed form, too"


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


def test_a_flange_that_is_not_there_or_does_not_move_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no link nowhere"):
        read_urdf(ARM, "odd", flange="nowhere")
    with pytest.raises(ConfigurationError, match="no joint moves the link base"):
        read_urdf(ARM, "odd", flange="base")


def test_unknown_arms_and_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"'kr6' is unknown; known are iiwa14, iiwa7, panda, ur5"):
        find_arm("kr6")
    with pytest.raises(ConfigurationError, match=r"none\.urdf cannot be read: No such file"):
        find_arm(str(tmp_path / "none.urdf"))
    (tmp_path / "binary.urdf").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(ConfigurationError, match="not UTF-8"):
        find_arm(str(tmp_path / "binary.urdf"))


def test_the_extra_is_named_where_the_package_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> Any:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(urdf_arms, "files", absent)
    urdf_arms._packaged_arm.cache_clear()
    with pytest.raises(ConfigurationError, match=r"example-robot-data .* install pcmrs-sim"):
        find_arm("panda")
