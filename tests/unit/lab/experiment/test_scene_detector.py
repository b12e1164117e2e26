"""Lines on standard input move the hand and harm the camera, and a wrong line changes nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs_lab.experiment.scene_detector import apply_line


def camera() -> Any:
    return SimpleNamespace(hand=None, occluded=False, frozen=False, moved=0.0)


def after(*lines: str) -> Any:
    found = camera()
    for line in lines:
        apply_line(cast(Any, found), line)
    return found


def test_lines_move_the_hand_and_harm_the_camera() -> None:
    assert after("hand 0.3 0.45 0.3").hand == (0.3, 0.45, 0.3)
    assert after("hand 0.3 0.45 0.3", "hand away").hand is None
    assert after("occlude on").occluded
    assert not after("freeze on", "freeze off").frozen
    assert after("move 0.5").moved == 0.5


@pytest.mark.parametrize("line", ["", "jump", "hand 1 2", "hand x y z", "occlude", "freeze maybe", "move", "move 1 2"])
def test_wrong_line_changes_nothing(line: str) -> None:
    found = camera()
    with pytest.raises(ConfigurationError, match=r"none of|cannot be done"):
        apply_line(found, line)
    assert found == camera()
