"""What a procedure with stimulation gathers.

The devices that a procedure with stimulation needs beside robot and tracker; a cell need not have them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from pcmrs.devices.protocols import Emg, Stimulator
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.fsm import Effect
from pcmrs.messages import Epoch, PoseMessage
from pcmrs.messages.setup import StimulationShown
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.mep import Mep
from pcmrs.tms.settings import Estimate
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.data import settle as settle_placement


def stimulator_of(cell: Cell) -> Stimulator:
    """The cell's stimulator. Raises `RefusalError` where there is none."""
    if cell.stimulator is None:
        text = "There is no stimulator: set stimulator.driver, such as sim or trigger, and restart the daemon."
        raise RefusalError("no_stimulator", text)
    return cell.stimulator


def emg_of(cell: Cell) -> Emg:
    """The cell's electromyograph. Raises `RefusalError` where there is none."""
    if cell.emg is None:
        text = "There is no electromyograph: set emg.driver, such as sim or lsl, and restart the daemon."
        raise RefusalError("no_emg", text)
    return cell.emg


def stimulator_there(run: Run) -> None:
    """Refuses without a stimulator."""
    stimulator_of(run.cell)


def emg_there(run: Run) -> None:
    """Refuses without an electromyograph: nothing could be learned from the pulse."""
    emg_of(run.cell)


def register_device_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these checks."""
    for check in (stimulator_there, emg_there):
        registry.check(check)


class Ceiling(msgspec.Struct, frozen=True):
    """The highest intensity that may be used, percent of the maximum stimulator output, and who has said so."""

    percent: float
    operator: str


class Response(msgspec.Struct, frozen=True, kw_only=True):
    """One pulse that was given, and what it evoked.

    Attributes:
        pulse: Number of the pulse.
        intensity: Percent of the maximum stimulator output.
        coil: ``image_from_coil`` in the newest frame of the tracker before the pulse.
        error_mm: Of the coil against its planned pose then.
        error_deg: The same for its rotation.
        mep: What was measured; None where there is no measurement.
        problem: Code of why it says nothing about the muscle; empty where it does.
        problem_text: The same for people.
    """

    pulse: int
    intensity: float
    coil: PoseMessage
    error_mm: float
    error_deg: float
    mep: Mep | None = None
    problem: str = ""
    problem_text: str = ""


class Data(PlacementData, frozen=True, kw_only=True):
    """What a procedure with stimulation gathers.

    The cell's time means nothing after a restart; `last_pulse` is then unknown, and the interval counts from arming.
    So it does where the stimulator has counted pulses that this procedure has not: their outcome was unknown.

    Attributes:
        ceiling: None until the operator has set it; then nothing above it is ever asked of the stimulator.
        intensity: Of the next pulse, percent of the maximum stimulator output; None until it has been set.
        pulse: Number of the last pulse, by this procedure or by the stimulator, whichever is greater.
        given: Pulses since the daemon began.
        last_pulse: When it was given, s of the cell's clock; None before this daemon has armed the stimulator.
        response: To the last pulse whose outcome is known; all of them are in the journal.
        epoch: The signal that it was judged by; None where there is none.
        search: Of the hot-spot, under way or concluded.
        search_intensity: That all its pulses are given at, percent.
        hotspot: ``image_from_coil`` at the hot-spot; None until it is found.
        hunt: For the threshold, under way or concluded.
        threshold: None until it is found.
    """

    ceiling: Ceiling | None = None
    intensity: float | None = None
    pulse: int = 0
    given: int = 0
    last_pulse: float | None = None
    response: Response | None = None
    epoch: Epoch | None = None
    search: HotspotSearch | None = None
    search_intensity: float | None = None
    hotspot: PoseMessage | None = None
    hunt: MotorThresholdEstimator | None = None
    threshold: Estimate | None = None

    def stimulation_view(self) -> StimulationShown:
        """What people are shown of the stimulation."""
        return StimulationShown(
            ceiling=None if self.ceiling is None else self.ceiling.percent,
            intensity=self.intensity,
            response=None if self.response is None else msgspec.to_builtins(self.response),
            hunt=None if self.hunt is None else msgspec.to_builtins(self.hunt),
        )

    def newest_epoch(self) -> Epoch | None:
        """Signal that the last pulse was judged by, if there is one."""
        return self.epoch


Run = AnyRun[Cell, Data]


def settle(data: Data, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Drops what the joint state no longer stands for. Pure."""
    changes: dict[str, object] = {}
    if states["hotspot"] == "none":
        changes |= {"search": None, "search_intensity": None, "hotspot": None}
    if states["threshold"] == "none":
        changes |= {"hunt": None, "threshold": None}
    fitted = msgspec.structs.replace(data, **changes) if changes else data
    return settle_placement(fitted, states, effects)
