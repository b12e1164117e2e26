"""Intensity of the next pulse, and its ceiling."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.workflows._arguments import PersonName
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Ceiling, Data, Run, stimulator_of

Percent = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]

INTENSITY_TOLERANCE = 0.5
"""Largest difference between a requested and a reported intensity, percent. Stimulators are set in whole percent."""


class AskedCeiling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `set_ceiling`.

    Attributes:
        percent: Greatest permitted intensity, percent of the maximum stimulator output.
        operator: Name of the responsible person.
    """

    percent: Percent
    operator: PersonName


class AskedIntensity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `set_intensity`.

    Attributes:
        percent: Intensity of the next pulse, percent of the maximum stimulator output.
    """

    percent: Percent


def keep_ceiling(run: Run) -> None:
    """Put the ceiling in force, and the responsible person on record."""
    run.keep(ceiling=Ceiling(run.payload.percent, run.payload.operator))
    run.result |= {"ceiling": run.payload.percent, "operator": run.payload.operator}


def asked_intensity_allowed(run: Run) -> None:
    """Refuse a requested intensity above the ceiling, or without a ceiling."""
    check_intensity(run.data, run.payload.percent)


def intensity_allowed(run: Run) -> None:
    """Refuse to go on if no intensity has been set, or if the ceiling was lowered below it since."""
    check_intensity(run.data, known_intensity(run.data))


def known_intensity(data: Data) -> float:
    """Return the intensity of the next pulse, percent of the maximum stimulator output.

    Raises:
        RefusalError: No intensity has been set.
    """
    if data.intensity is None:
        raise RefusalError("no_intensity", "No intensity has been set: send stimulation.set_intensity first.")
    return data.intensity


def check_intensity(data: Data, percent: float) -> None:
    """Refuse an intensity above the ceiling, or any without a ceiling.

    Args:
        data: Data of the procedure.
        percent: Intensity, percent of the maximum stimulator output.

    Raises:
        RefusalError: ``no_ceiling`` or ``intensity_over_ceiling``.
    """
    if data.ceiling is None:
        text = "No ceiling of the intensity has been set: an operator must send stimulation.set_ceiling."
        raise RefusalError("no_ceiling", text)
    # The negated comparison refuses nan, too.
    if not percent <= data.ceiling.percent:
        text = (
            f"{percent:g} % is above the ceiling of {data.ceiling.percent:g} %, set by {data.ceiling.operator}. Choose "
            "less, or disarm and have the ceiling changed."
        )
        raise RefusalError("intensity_over_ceiling", text, percent=percent, ceiling=data.ceiling.percent)


async def set_asked_intensity(run: Run) -> None:
    """Set the requested intensity."""
    await set_intensity(run, run.payload.percent)


async def set_intensity(run: Run, percent: float) -> None:
    """Set the intensity of the next pulse.

    Args:
        run: Present operation.
        percent: Intensity, percent of the maximum stimulator output.

    Raises:
        RefusalError: The stimulator reports another intensity.
        DeviceError: The stimulator refuses.
        UnknownOutcomeError: The stimulator does not answer.
    """
    state = await stimulator_of(run.cell).set_intensity(percent)
    check_reported(percent, state.intensity)
    run.keep(intensity=percent)
    run.result["intensity"] = percent


def check_reported(percent: float, reported: float | None) -> None:
    """Refuse a stimulator that reports another intensity. A stimulator that reports none is trusted.

    Args:
        percent: Requested intensity, percent of the maximum stimulator output.
        reported: Reported intensity in the same unit; None if the stimulator cannot report it.

    Raises:
        RefusalError: ``intensity_differs``.
    """
    if reported is not None and not abs(reported - percent) <= INTENSITY_TOLERANCE:
        text = (
            f"The stimulator reports {reported:g} %, not {percent:g} %: somebody has turned its dial, or it cannot be "
            "set to this value. Send stimulation.set_intensity."
        )
        raise RefusalError("intensity_differs", text, reported=reported, percent=percent)


def register_intensity(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these payloads, checks and steps."""
    registry.payload("ceiling", AskedCeiling)
    registry.payload("intensity", AskedIntensity)
    for check in (asked_intensity_allowed, intensity_allowed):
        registry.check(check)
    registry.step(keep_ceiling)
    registry.world_step(set_asked_intensity)
