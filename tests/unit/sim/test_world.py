"""The true state of the simulated cell."""

import numpy as np
import pytest

from pcmrs.clock import Clock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.spatial import distance
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.opening import open_devices
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.settings import SimSettings
from pcmrs_sim.world import World
from tests.unit.sim.cell_readings import transform


@pytest.mark.parametrize("name", PHANTOMS)
async def test_the_chosen_phantom_stands_where_it_belongs(name: str, clock: Clock) -> None:
    geometry, phantom = SimSettings().geometry, PHANTOMS[name]
    async with open_devices(("scene",), {"sim": {"phantom": name}}, clock) as devices:
        truth = await devices["scene"].truth()
    tracker_from_image = transform(truth.tracker_from_body_ref) @ transform(truth.body_ref_from_image)
    world_from_image = geometry.world_from_tracker.transform @ tracker_from_image
    assert distance(world_from_image, phantom.world_from_image) < 1e-9
    assert distance(transform(truth.body_ref_from_image), phantom.body_ref_from_image) < 1e-9


async def test_a_configured_place_is_taken_instead(clock: Clock) -> None:
    place = {"position": (0.6, 0.1, 0.2), "quat_wxyz": (0.5, 0.5, 0.5, 0.5)}
    sim = {"phantom": "femur", "geometry": {"world_from_image": place, "body_ref_from_image": place}}
    async with open_devices(("scene",), {"sim": sim}, clock) as devices:
        truth = await devices["scene"].truth()
    world_from_tracker = SimSettings().geometry.world_from_tracker.transform
    assert (world_from_tracker @ transform(truth.tracker_from_body_ref)).matrix == pytest.approx(np.eye(4), abs=1e-6)


def make_world(phantom: str) -> World:
    settings = SimSettings(phantom=phantom)  # type: ignore[arg-type]
    return World(settings, ARMS["iiwa14"], ForceSettings(), 0.0)


def test_only_a_head_answers_and_only_where_it_is_stimulated() -> None:
    world = make_world("head")
    told: list[tuple[int, float, float]] = []
    world.pulse_listeners.append(lambda *pulse: told.append(pulse))
    world.stimulate(1, 100.0, 50.0)
    far = world.muscle.stimulus(1)
    assert far is not None
    assert far.amplitude < 50e-6  # the arm is at home
    assert told == [(1, 100.0, 50.0)]
    subject = draw_subject("head", world.settings.seed)
    assert subject is not None
    assert world.muscle.stimulate(2, 60.0, subject.image_from_hotspot, 100.0).amplitude > 50e-6
    bone = make_world("femur")
    bone.stimulate(1, 100.0, 50.0)
    none = bone.muscle.stimulus(1)
    assert none is not None
    assert none.amplitude == 0.0


def test_another_seed_is_another_subject() -> None:
    world = make_world("head")
    before = world.muscle.subject
    world.reseed(2)
    assert world.muscle.subject != before
