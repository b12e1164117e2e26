"""Arms from URDF, with Pinocchio's reading of the same documents as the oracle."""

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics._urdf_reader import STIFFNESS, read_urdf
from pcmrs.kinematics.model import ArmModel
from tests.unit.kinematics.urdf_documents import ARM, assert_same_arm, without


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


def test_a_flange_that_is_not_there_or_does_not_move_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no link nowhere"):
        read_urdf(ARM, "odd", flange="nowhere")
    with pytest.raises(ConfigurationError, match="no joint moves the link base"):
        read_urdf(ARM, "odd", flange="base")
