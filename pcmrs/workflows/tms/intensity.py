"""The intensity of the next pulse, and the ceiling that none goes above."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.workflows.arguments import PersonName
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Ceiling, Data, Run, stimulator_of

Percent = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]

SAME_PERCENT = 0.5
"""Stimulators are set in whole percent: what they report nearer than this is what was asked for."""


class AskedCeiling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `set_ceiling`: percent of the maximum stimulator output, and who answers for it."""

    percent: Percent
    operator: PersonName


class AskedIntensity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `set_intensity`: percent of the maximum stimulator output."""

    percent: Percent


def keep_ceiling(run: Run) -> None:
    """Puts the ceiling in force, and who has set it on record."""
    run.keep(ceiling=Ceiling(run.payload.percent, run.payload.operator))
    run.result |= {"ceiling": run.payload.percent, "operator": run.payload.operator}


def asked_intensity_allowed(run: Run) -> None:
    """Refuses an intensity above the ceiling, or while there is none."""
    check_intensity(run.data, run.payload.percent)


def intensity_allowed(run: Run) -> None:
    """Refuses to go on while no intensity has been set, or that is above a ceiling that was lowered since."""
    check_intensity(run.data, known_intensity(run.data))


def known_intensity(data: Data) -> float:
    """Of the next pulse, percent of the maximum stimulator output. Raises `RefusalError` where none has been set."""
    if data.intensity is None:
        raise RefusalError("no_intensity", "No intensity has been set: ask for stimulation.set_intensity first.")
    return data.intensity


def check_intensity(data: Data, percent: float) -> None:
    """Refuses an intensity above the ceiling, or while there is none. Raises `RefusalError`."""
    if data.ceiling is None:
        text = "No ceiling of the intensity has been set: an operator does that, by stimulation.set_ceiling."
        raise RefusalError("no_ceiling", text)
    if not percent <= data.ceiling.percent:
        text = (
            f"{percent:g} % is above the ceiling of {data.ceiling.percent:g} %, set by {data.ceiling.operator}. Choose "
            "less, or disarm and have the ceiling set anew."
        )
        raise RefusalError("intensity_over_ceiling", text, percent=percent, ceiling=data.ceiling.percent)


async def set_asked_intensity(run: Run) -> None:
    """Sets what was asked for."""
    await set_intensity(run, run.payload.percent)


async def set_intensity(run: Run, percent: float) -> None:
    """Sets the intensity of the next pulse.

    Raises:
        RefusalError: The stimulator reports another one.
        DeviceError: It refuses.
        UnknownOutcomeError: It does not answer.
    """
    state = await stimulator_of(run.cell).set_intensity(percent)
    check_reported(percent, state.intensity)
    run.keep(intensity=percent)
    run.result["intensity"] = percent


def check_reported(percent: float, reported: float | None) -> None:
    """Refuses a stimulator that is not set to `percent`; one that cannot say is believed. Raises `RefusalError`."""
    if reported is not None and not abs(reported - percent) <= SAME_PERCENT:
        text = (
            f"The stimulator reports {reported:g} %, not {percent:g} %: somebody has turned its dial, or it cannot be "
            "set so. Ask for stimulation.set_intensity."
        )
        raise RefusalError("intensity_differs", text, reported=reported, percent=percent)


def register_intensity(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these payloads, checks and steps."""
    registry.payload("ceiling", AskedCeiling)
    registry.payload("intensity", AskedIntensity)
    for check in (asked_intensity_allowed, intensity_allowed):
        registry.check(check)
    registry.step(keep_ceiling)
    registry.world_step(set_asked_intensity)
