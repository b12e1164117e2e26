"""What a pulse evoked: measured, judged, and put on record. It was given, so nothing here fails it."""

from __future__ import annotations

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher.execution import reason_of
from pcmrs.errors import PcmrsError
from pcmrs.tms.mep import Mep, judge_mep
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Response, Run
from pcmrs.workflows.tms.devices import emg_of

PROBLEMS = {
    "saturated": "The amplifier was saturated.",
    "artefact": "The stimulus artefact reaches into the response.",
    "preactivated": "The muscle was active before the pulse.",
}
"""Flags of a measurement that says nothing about the muscle, the worst first."""


async def read_response(run: Run) -> None:
    """Reads the signal around the pulse, and judges what is in it; what goes wrong is told, not raised."""
    fired: Response = run.prepared
    settings = run.cell.settings.stimulation
    run.keep(epoch=None)
    try:
        epoch = await emg_of(run.cell).epoch(fired.pulse, settings.epoch_before, settings.epoch_after)
        run.keep(epoch=epoch)
        run.prepared = _judged(fired, judge_mep(epoch, settings.mep))
    except PcmrsError as error:
        reason = reason_of(error)
        run.prepared = msgspec.structs.replace(fired, problem=reason.code, problem_text=reason.text)


def _judged(fired: Response, mep: Mep) -> Response:
    problem = next((flag for flag in PROBLEMS if getattr(mep, flag)), "")
    return msgspec.structs.replace(fired, mep=mep, problem=problem, problem_text=PROBLEMS.get(problem, ""))


def keep_response(run: Run) -> None:
    """Puts the response on record, and in the result."""
    response: Response = run.prepared
    run.keep(response=response)
    run.result |= {**msgspec.to_builtins(response), "counted": not response.problem}


def register_response(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these steps."""
    registry.world_step(read_response)
    registry.step(keep_response)
