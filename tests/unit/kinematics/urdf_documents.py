"""An odd arm as URDF, and Pinocchio's reading of a document as the oracle, for tests."""

from xml.etree.ElementTree import fromstring, tostring

import numpy as np
import pinocchio

from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf

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
