"""Arming and disarming of the stimulator, and its supervision while it is armed."""

from __future__ import annotations

from contextlib import suppress

from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.messages import StimulatorState
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Run, stimulator_of
from pcmrs.workflows.tms.intensity import known_intensity, set_intensity

Activity = AnyActivity[Cell, PlacementData]

POLL_INTERVAL = 0.2
"""Time between two queries of the armed stimulator's state, s."""


async def arm_stimulator(run: Run) -> None:
    """Set the intensity and charge the stimulator. Any failure leaves it disarmed.

    Raises:
        RefusalError: The stimulator is not armed afterwards, or reports another intensity.
        DeviceError: The stimulator refuses.
        UnknownOutcomeError: The stimulator does not answer.
    """
    stimulator = stimulator_of(run.cell)
    try:
        await set_intensity(run, known_intensity(run.data))
        state = await stimulator.arm()
        _check_armed(state)
    except BaseException:  # includes a deadline and Stop
        with suppress(PcmrsError):
            await stimulator.disarm()
        raise
    _adopt_pulse_count(run, state)


def _check_armed(state: StimulatorState) -> None:
    if not state.armed:
        raise RefusalError("not_armed", "The stimulator was commanded to arm, but is not armed: check it.")


def _adopt_pulse_count(run: Run, state: StimulatorState) -> None:
    """Adopt the stimulator's number of pulses. If it has counted more, the interval starts now."""
    data = run.data
    if data.last_pulse is None or state.pulse > data.pulse:
        run.keep(last_pulse=run.clock.monotonic())
    if state.pulse > data.pulse:
        known = data.last_pulse is not None  # pulses before the start of this daemon belong to another session
        run.keep(pulse=state.pulse, given=data.given + (state.pulse - data.pulse if known else 0))


async def disarm_stimulator(run: Run) -> None:
    """Disarm the stimulator.

    Raises:
        DeviceError: The stimulator refuses.
        UnknownOutcomeError: The stimulator does not answer.
    """
    await stimulator_of(run.cell).disarm()


async def watch_stimulator(act: Activity) -> None:
    """Show the state of the armed stimulator, report when it is no longer armed, and disarm it at the end.

    Stop also disarms the stimulator, and this activity detects that. A stimulator that does not answer is a hazard, so
    its failure ends the activity with an error.

    Raises:
        DeviceError: The stimulator refuses to report its state.
        UnknownOutcomeError: The stimulator does not answer.
    """
    stimulator, reported = stimulator_of(act.cell), False
    try:
        while True:
            state = await stimulator.state()
            act.show(ready=state.ready, intensity=state.intensity, coil_temperature=state.coil_temperature)
            if not state.armed and not reported:
                reported = True
                act.post("stimulation", "disarmed")
            await act.clock.sleep(POLL_INTERVAL)
    finally:
        with suppress(PcmrsError):
            await stimulator.disarm()


def register_arming(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these steps and this activity."""
    registry.world_step(arm_stimulator, affects_patient=True)
    registry.world_step(disarm_stimulator)
    registry.activity(watch_stimulator)
