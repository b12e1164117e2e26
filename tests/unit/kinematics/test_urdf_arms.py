"""Arms from URDF, with Pinocchio's reading of the same documents as the oracle."""

from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics import urdf_arms
from pcmrs.kinematics._geometry import SrsGeometry
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.urdf_documents import assert_same_arm, without

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
    assert isinstance(ArmModel(facts).geometry, SrsGeometry), "its inverse kinematics is in closed form, too"


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
