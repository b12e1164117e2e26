"""A background tells what is new before it, and when the camera cannot see the scene any more."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.scene._background import Background

SHAPE = (20, 30)
NOTHING = np.zeros(SHAPE, dtype=bool)
UNHIDDEN = np.zeros(SHAPE, dtype=np.float32)


def wall(depth: float = 2.0) -> np.ndarray:
    return np.full(SHAPE, depth, dtype=np.float32)


def background() -> Background:
    rng = np.random.default_rng(1)
    return Background([wall() + rng.normal(0.0, 0.003, SHAPE) for _ in range(10)], UNHIDDEN, 0.03)


def test_object_before_the_wall_is_found_pixel_by_pixel() -> None:
    seen = wall()
    seen[5:10, 10:15] = 1.5
    before = background().before(seen)
    assert before.sum() == 25
    assert before[5:10, 10:15].all()


def test_noise_and_missing_depth_are_no_objects() -> None:
    noisy = wall() + np.random.default_rng(2).normal(0.0, 0.003, SHAPE).astype(np.float32)
    noisy[0, :] = 0.0
    assert not background().before(noisy).any()


def test_object_where_nothing_was_measured_is_found() -> None:
    empty = np.array([wall()] * 10)
    empty[:, :, :5] = 0.0
    seen = wall()
    assert Background(empty, UNHIDDEN, 0.03).before(seen)[:, :5].all()


def test_camera_without_a_view_says_why() -> None:
    known = background()
    assert known.trouble(wall(), NOTHING) == ""
    assert known.trouble(wall(0.0), NOTHING) == "occluded"
    assert known.trouble(wall(0.4), NOTHING) == "occluded"
    assert known.trouble(wall(2.5), NOTHING) == "camera_moved"


def test_arm_before_the_lens_does_not_count_as_occlusion() -> None:
    seen, arm = wall(), np.zeros(SHAPE, dtype=bool)
    arm[:, :24] = True
    seen[arm] = 0.5
    assert background().trouble(seen, arm) == ""
    assert background().trouble(seen, NOTHING) == "occluded"


def test_what_the_arm_hid_is_background_once_it_is_seen() -> None:
    arm = np.zeros(SHAPE, dtype=bool)
    arm[:, :10] = True
    known = Background([np.where(arm, 0.0, wall())] * 10, np.where(arm, 1.0, 0.0).astype(np.float32), 0.03)
    assert not known.before(wall()).any(), "behind the arm may be anything"
    assert known.before(wall(0.9))[arm].all(), "but nothing was before it"
    assert known.trouble(wall(), NOTHING) == ""
    revealed = known.hidden_before(wall())
    assert (revealed == arm).all()
    known.reveal(wall(), revealed)
    assert not known.hidden_before(wall()).any()
    assert known.before(wall(1.5))[arm].all()


@pytest.mark.parametrize(
    ("depths", "text"),
    [([wall()] * 4, "at least 5"), ([wall(0.0)] * 10, "Only 0%"), (wall(), "at least 5")],
    ids=["few", "unknown", "one"],
)
def test_background_needs_enough_images(depths: list[np.ndarray], text: str) -> None:
    with pytest.raises(GeometryError, match=text):
        Background(depths, UNHIDDEN, 0.03)
