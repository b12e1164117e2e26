"""One pulse: at its place, armed, below the ceiling, not too soon, never twice; and its response.

The response is measured, evaluated and put on record. The pulse was given, so no failure of the measurement fails it.
"""

from __future__ import annotations

from contextlib import suppress

import msgspec

from pcmrs.devices.protocols import Stimulator
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher.execution import reason_of
from pcmrs.errors import PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.messages import FiredPulse, StimulatorState
from pcmrs.tms.intervals import check_count, check_interval
from pcmrs.tms.mep import Mep, judge_mep
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message
from pcmrs.workflows.tms.coil_alignment import check_coil_alignment
from pcmrs.workflows.tms.data import Data, Response, Run, emg_of, stimulator_of
from pcmrs.workflows.tms.intensity import check_intensity, check_reported, known_intensity

PROBLEMS = {
    "saturated": "The amplifier was saturated.",
    "artefact": "The stimulus artefact reaches into the response.",
    "preactivated": "The muscle was active before the pulse.",
}
"""Texts by the flag of an invalid measurement, the worst first."""

POLL_INTERVAL = 0.02
"""Time between two queries of a stimulator that charges, s."""


def pulse_allowed_now(run: Run) -> None:
    """Refuse a pulse too soon after the last one, or after too many: the published limits of single pulses."""
    limits, data = run.cell.settings.stimulation.intervals, run.data
    check_interval(run.clock.monotonic(), data.last_pulse, data.given, limits)
    check_count(data.given, limits)


async def fire_pulse(run: Run) -> None:
    """Fire once as soon as the stimulator is ready; all conditions are checked again immediately before.

    The number of the pulse was never used before, so a command that is delivered twice fires once. If it is unknown
    whether the stimulator fired, it is disarmed, and the interval restarts when it is armed again.

    Raises:
        RefusalError: The stimulator is not ready, or its report does not fit; coil or head are not at their place.
        DeviceError: The stimulator refuses.
        UnknownOutcomeError: The stimulator does not answer.
    """
    stimulator, intensity = stimulator_of(run.cell), known_intensity(run.data)
    check_intensity(run.data, intensity)
    _check_state(run.data, await _ready(run, stimulator))
    alignment, number = check_coil_alignment(run.cell, run.data), run.data.pulse + 1
    fired = await _fire(stimulator, number)
    # Only a confirmed pulse is counted here. After an unknown outcome, arming adopts the stimulator's own count.
    run.keep(pulse=number, given=run.data.given + 1, last_pulse=run.clock.monotonic())
    run.prepared = Response(
        pulse=number,
        intensity=intensity if fired.intensity is None else fired.intensity,
        coil=as_message(alignment.image_from_coil),
        error_mm=alignment.error_mm,
        error_deg=alignment.error_deg,
    )


async def _ready(run: Run, stimulator: Stimulator) -> StimulatorState:
    """Return the state of an armed and charged stimulator. Raises `RefusalError` if it does not get ready in time."""
    limit = run.cell.settings.stimulation.ready_time
    until = run.clock.monotonic() + limit
    while True:
        state = await stimulator.state()
        if state.armed and state.ready:
            return state
        if not state.armed or run.clock.monotonic() >= until:
            break
        await run.clock.sleep(POLL_INTERVAL)
    warm = "" if state.coil_temperature is None else f", its coil at {state.coil_temperature:.0f} °C"
    text = (
        f"The stimulator is {'armed' if state.armed else 'not armed'}{warm}, and not ready to fire within {limit:g} s."
    )
    text += " Let it charge and cool; arm it if it is not armed."
    raise RefusalError("stimulator_not_ready", text, armed=state.armed, coil_temperature=state.coil_temperature)


def _check_state(data: Data, state: StimulatorState) -> None:
    check_reported(known_intensity(data), state.intensity)
    if state.pulse > data.pulse:
        text = (
            f"The stimulator has fired pulse {state.pulse}; this procedure knows of {data.pulse}. Somebody else fires "
            "it, or the outcome of a pulse was unknown: disarm it and arm it again."
        )
        raise RefusalError("pulse_unaccounted", text, pulse=state.pulse, known=data.pulse)


async def _fire(stimulator: Stimulator, number: int) -> FiredPulse:
    try:
        return await stimulator.fire(number)
    except UnknownOutcomeError:
        with suppress(PcmrsError):
            await stimulator.disarm()
        raise


async def read_response(run: Run) -> None:
    """Read and evaluate the signal around the pulse. Failures are reported in the response, not raised."""
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
    """Put the response on record and in the result."""
    response: Response = run.prepared
    run.keep(response=response)
    run.result |= {**msgspec.to_builtins(response), "counted": not response.problem}


def register_pulse(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for this check and these steps."""
    registry.check(pulse_allowed_now)
    registry.world_step(fire_pulse, affects_patient=True)
    registry.world_step(read_response)
    registry.step(keep_response)
