"""Touching with the pointer: the position of its tip, and how still it was held."""

from __future__ import annotations

from collections.abc import Awaitable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.messages import TouchPrompt
from pcmrs.registration import rms_spread
from pcmrs.spatial import Floats
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import Landmark, PlacementData

Run = AnyRun[Cell, PlacementData]

FRAMES_TIME = 5.0
"""Longest wait for the frames of a touch, s. Without them, pointer or reference are not seen."""


@dataclass(frozen=True, eq=False)
class TouchMeasurement:
    """Measurement of one touch.

    Attributes:
        point: Mean of the tip over the frames, in body_ref, m, (3,).
        spread: Root mean square distance of the tip in the frames from the mean, m.
        since: Earliest capture time of the frames, s of the clock.
    """

    point: Floats
    spread: float
    since: float


AWAITED, TAKEN, CLOUD_TAKEN = 3, 2, 5
"""Numbers of beeps when a touch is awaited, after a landmark, and after points of the skin, as of the public daemon."""

HOLD_STILL = (
    "hold the tip still there. If it rests there already, that counts, unless another landmark was taken there."
)


def landmark_prompt(landmark: Landmark, number: int, count: int) -> TouchPrompt:
    """Return the prompt for a landmark.

    Args:
        landmark: The landmark.
        number: Its number in the plan, from 1.
        count: Number of planned landmarks.
    """
    text = f"Touch landmark {number} of {count}, {landmark.name}: {HOLD_STILL}"
    return TouchPrompt(text=text, landmark=landmark.name, number=number, count=count)


async def touch(run: Run, request: Awaitable[None], target: str, prompt: TouchPrompt) -> TouchMeasurement:
    """Prompt for a touch, wait until the person holds the tip on the target, and measure the tip.

    Args:
        run: Present operation.
        request: Request to the pointer, which ends when the person confirms the touch.
        target: Name of the target for texts.
        prompt: Prompt that is shown meanwhile.

    Raises:
        RefusalError: The target is not touched in time, pointer or reference are not seen, or the samples spread too
            far.
    """
    cell, settings = run.cell, run.cell.settings.registration
    run.prompt(prompt)
    cell.beep(AWAITED)
    try:
        async with run.clock.timeout(settings.touch_timeout_s):
            await request
        since = run.clock.monotonic()
        frames = await cell.poses.collect(["body_ref", "pointer"], settings.samples, timeout=FRAMES_TIME)
    except TimeoutError:
        text = f"{target} was not touched within {settings.touch_timeout_s:g} s; send the command again."
        raise RefusalError("not_touched", text, limit=settings.touch_timeout_s) from None
    finally:
        run.prompt(None)
        with suppress(PcmrsError):  # the failure of the touch itself is the one to report
            await cell.pointer.release()
    tip = cell.pointer_from_tip.translation
    tips = np.array([frame["body_ref"].inverse() @ (frame["pointer"] @ tip) for frame in frames])
    return TouchMeasurement(tips.mean(axis=0), _held_still(rms_spread(tips), settings.spread_limit_mm, target), since)


def _held_still(spread: float, limit_mm: float, target: str) -> float:
    limit = limit_mm / 1000.0
    if not spread <= limit:
        text = (
            f"The samples of {target} spread {spread * 1000:.2f} mm, the limit is {limit_mm:.2f} mm. Hold the pointer "
            "still and touch it again."
        )
        raise RefusalError("spread_too_large", text, spread=spread, limit=limit)
    return spread
