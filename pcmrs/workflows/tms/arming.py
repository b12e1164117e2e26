"""Arming and disarming the stimulator, and watching it while it is armed."""

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

LOOK_EVERY = 0.2
"""How often the armed stimulator is asked for its state, s."""


async def arm_stimulator(run: Run) -> None:
    """Sets the intensity and charges; whatever comes between leaves the stimulator disarmed.

    Raises:
        RefusalError: It has not become armed, or reports another intensity.
        DeviceError: It refuses.
        UnknownOutcomeError: It does not answer.
    """
    stimulator = stimulator_of(run.cell)
    try:
        await set_intensity(run, known_intensity(run.data))
        state = await stimulator.arm()
        _check_armed(state)
    except BaseException:  # a deadline and Stop among it
        with suppress(PcmrsError):
            await stimulator.disarm()
        raise
    _count_as_the_stimulator(run, state)


def _check_armed(state: StimulatorState) -> None:
    if not state.armed:
        raise RefusalError("not_armed", "The stimulator has been told to arm, but is not armed: look at it.")


def _count_as_the_stimulator(run: Run, state: StimulatorState) -> None:
    """Takes over the stimulator's number of pulses; where it tells of others, the interval counts from now."""
    data = run.data
    if data.last_pulse is None or state.pulse > data.pulse:
        run.keep(last_pulse=run.clock.monotonic())
    if state.pulse > data.pulse:
        known = data.last_pulse is not None  # what it has fired before this daemon began is of another session
        run.keep(pulse=state.pulse, given=data.given + (state.pulse - data.pulse if known else 0))


async def disarm_stimulator(run: Run) -> None:
    """Disarms.

    Raises:
        DeviceError: It refuses.
        UnknownOutcomeError: It does not answer.
    """
    await stimulator_of(run.cell).disarm()


async def watch_stimulator(act: Activity) -> None:
    """Shows what the armed stimulator says of itself, and tells when it is armed no more; disarms it at the end.

    Stop disarms the stimulator, too: then this finds out. One that does not answer is a danger.

    Raises:
        DeviceError: It refuses to say.
        UnknownOutcomeError: It does not answer.
    """
    stimulator, told = stimulator_of(act.cell), False
    try:
        while True:
            state = await stimulator.state()
            act.show(ready=state.ready, intensity=state.intensity, coil_temperature=state.coil_temperature)
            if not state.armed and not told:
                told = True
                act.post("stimulation", "disarmed")
            await act.clock.sleep(LOOK_EVERY)
    finally:
        with suppress(PcmrsError):
            await stimulator.disarm()


def register_arming(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these steps and this activity."""
    registry.world_step(arm_stimulator, affects_patient=True)
    registry.world_step(disarm_stimulator)
    registry.activity(watch_stimulator)
