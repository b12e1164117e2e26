"""Touches of the simulated person with the pointer."""

import asyncio

import numpy as np
import pytest

from pcmrs.errors import DeviceError
from pcmrs.messages import LandmarkPrompt
from pcmrs.spatial import Floats
from pcmrs_sim.error_models import TouchErrors
from pcmrs_sim.settings import DigitizationSettings, SimSettings
from tests.unit.sim.cell_readings import Devices, next_frames, transform

PROMPT = LandmarkPrompt(index=2, name="left_outer_canthus", position_in_image=(-0.0456, 0.0691, 0.035))


async def measured_tip(devices: Devices) -> Floats:
    """The touched point in the image as mean over ten frames, with the true registration."""
    tip_in_pointer = SimSettings().geometry.pointer_from_tip.position
    truth = await devices["scene"].truth()
    tips = []
    for _, body_ref, pointer, _ in await next_frames(devices, 10):
        body_ref_from_pointer = transform(body_ref).inverse() @ transform(pointer)
        tips.append(transform(truth.body_ref_from_image).inverse() @ body_ref_from_pointer @ tip_in_pointer)
    return np.asarray(np.mean(tips, axis=0))


async def test_touches_share_a_bias_and_a_displacement_acts_once(cell: Devices) -> None:
    tips = []
    for offset in (0.0, 0.025, 0.0):
        if offset:
            await cell["scene"].displace_touch(PROMPT.index, (offset, 0.0, 0.0))
        await cell["pointer"].touch(PROMPT)
        tips.append(await measured_tip(cell))
    first, displaced, last = tips
    assert np.linalg.norm(first - last) < 0.006
    assert displaced[0] - (first[0] + last[0]) / 2 == pytest.approx(0.025, abs=0.006)
    await cell["pointer"].release()
    assert not (await next_frames(cell, 5))[-1][2].valid


async def test_the_tip_moves_with_the_patient(cell: Devices) -> None:
    await cell["pointer"].touch(PROMPT)
    before = await measured_tip(cell)
    await cell["scene"].move_body((0.02, 0.01, 0.0))
    await next_frames(cell, 5)
    assert np.linalg.norm(await measured_tip(cell) - before) < 5e-4


async def test_hand_released_on_its_way_does_not_continue(cell: Devices) -> None:
    touching = asyncio.create_task(cell["pointer"].touch(PROMPT))
    await next_frames(cell, 1)
    await cell["pointer"].release()
    with pytest.raises(DeviceError, match="released before it reached"):
        await touching
    for _, _, pointer, _ in await next_frames(cell, 5):
        assert not pointer.valid


async def test_a_touch_lands_where_the_seed_says(cell: Devices) -> None:
    for seed in (3, 4):
        await cell["scene"].reseed(seed)
        await cell["pointer"].touch(PROMPT)
        expected = PROMPT.position_in_image + TouchErrors(DigitizationSettings(), seed).next(PROMPT.index)
        assert np.linalg.norm(await measured_tip(cell) - expected) < 5e-4
