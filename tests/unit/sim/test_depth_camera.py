"""The simulated depth camera, and the detector with it: what enters is found, and arm and body never are."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator

import numpy as np
import pytest

from pcmrs.config import as_table
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import SceneEvent
from pcmrs.scene.depth_frame import DepthFrame
from pcmrs.scene.detector import IntrusionDetector, SceneView
from pcmrs.scene_node import SceneNode, known_bodies
from pcmrs.settings import Settings, read_settings
from pcmrs.spatial import Floats
from pcmrs.testing.clock import ManualClock
from pcmrs_sim.depth_camera import SimulatedDepthCamera, open_simulated

HOME = np.array(find_arm("iiwa14").home)
RANDOM = 40
"""Number of random directions."""


def camera_of(settings: Settings, joints: Callable[[], Floats]) -> SimulatedDepthCamera:
    own = settings.scene_camera
    return open_simulated(as_table(settings), joints, own.pose.transform(), own.rate_hz)


class Watched:
    """A cell whose empty scene the detector knows."""

    def __init__(self, joints: Floats = HOME) -> None:
        self.settings: Settings = read_settings()
        self.joints = joints
        self.camera: SimulatedDepthCamera = camera_of(self.settings, lambda: self.joints)
        own = self.settings.scene_camera
        self.detector = IntrusionDetector(own, self.camera.intrinsics, known_bodies(self.settings))
        for _ in range(own.background_frames):
            assert self.look().blind == "learning"
        assert self.detector.learned

    def look(self) -> SceneView:
        return self.detector.look(self.camera.look(), self.joints)


@pytest.fixture(scope="module")
def scene() -> Watched:
    return Watched()


@pytest.fixture
def watched(scene: Watched) -> Iterator[Watched]:
    yield scene
    scene.camera.hand, scene.joints = None, HOME
    scene.camera.occluded = scene.camera.frozen = False
    scene.camera.moved = 0.0
    for _ in range(6):
        scene.look()


def postures() -> list[Floats]:
    """Random postures near home, above the bench and in front of the base."""
    rng, model = np.random.default_rng(7), ArmModel(find_arm("iiwa14"))
    found: list[Floats] = []
    while len(found) < RANDOM:
        q = HOME + rng.uniform(-0.6, 0.6, len(HOME))
        if model.joint_origins(q)[:, 2].min() > -0.05:
            found.append(q)
    return found


def test_moving_arm_and_body_are_no_intrusion(watched: Watched) -> None:
    for q in postures():
        watched.joints = q
        view = watched.look()
        assert (view.blind, view.tracks) == ("", [])


def test_background_behind_the_arm_is_learned_when_it_leaves() -> None:
    """The detector starts while the tool is at the body."""
    at_body = np.array((0.014, 0.530, -0.003, -1.955, -0.019, 0.670, -1.543))
    scene = Watched(at_body)
    for q in (at_body, *postures()):
        scene.joints = q
        assert scene.look().tracks == []
    scene.camera.hand = (0.3, 0.45, 0.3)
    scene.look()
    assert len(scene.look().tracks) == 1


def test_hand_is_found_where_it_is(watched: Watched) -> None:
    watched.camera.hand = (0.3, 0.45, 0.3)
    watched.look()
    (track,) = watched.look().tracks
    assert track.cluster.zone == "workspace"
    assert np.linalg.norm(track.cluster.middle - (0.3, 0.45, 0.4)) < 0.15
    assert track.confidence == 1.0


def test_hands_from_random_directions_are_all_found(watched: Watched) -> None:
    """They stop at the edge of the zone, on the sides that the camera sees."""
    rng = np.random.default_rng(3)
    missed = []
    for _ in range(RANDOM):
        x, y = rng.uniform(0.1, 0.9), rng.choice((-0.5, 0.5))
        watched.camera.hand = (float(x), float(y), float(rng.uniform(0.1, 0.6)))
        if not watched.look().tracks:
            missed.append(watched.camera.hand)
    assert missed == []


def test_hand_beyond_the_zone_is_not_reported(watched: Watched) -> None:
    watched.camera.hand = (0.3, 1.2, 0.3)
    assert watched.look().tracks == []


def test_detector_says_why_it_cannot_see(watched: Watched) -> None:
    watched.camera.occluded = True
    assert watched.look().blind == "occluded"
    watched.camera.occluded = False
    watched.camera.moved = 0.5
    assert watched.look().blind == "camera_moved"
    watched.camera.moved = 0.0
    watched.camera.frozen = True
    watched.look()
    assert watched.look().blind == "frozen"
    assert watched.detector.look(watched.camera.look(), None).blind in ("frozen", "no_joints")


class Played:
    """A camera that shows given images."""

    def __init__(self, camera: SimulatedDepthCamera, images: list[DepthFrame]) -> None:
        self.intrinsics = camera.intrinsics
        self._images = images

    async def frames(self) -> AsyncIterator[DepthFrame]:
        for each in self._images:
            yield each

    def close(self) -> None:
        """Nothing is open."""


async def test_node_publishes_detections_before_its_sign_of_life() -> None:
    settings, published = read_settings(), list[tuple[str, SceneEvent]]()
    camera = camera_of(settings, lambda: HOME)
    images = [camera.look() for _ in range(settings.scene_camera.background_frames)]
    camera.hand = (0.3, 0.45, 0.3)
    images += [camera.look() for _ in range(2)]
    node = SceneNode(
        lambda key, event: published.append((key, event)),
        "cam1",
        settings,
        Played(camera, images),
        lambda: HOME,
        ManualClock(),
    )
    await node.run()
    assert {key for key, _ in published} == {"scene/cam1"}
    labels = [event.label for _, event in published]
    assert labels == ["blind"] * 10 + ["intrusion", "watching"] * 2
    assert published[-2][1].confidence == 1.0
    assert node.summary().intrusions == 1
