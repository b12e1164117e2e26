"""Data of a procedure with stimulation, and its optional devices.

A cell need not have a stimulator or an electromyograph.
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


class Ceiling(msgspec.Struct, frozen=True):
    """Greatest permitted intensity.

    Attributes:
        percent: Intensity, percent of the maximum stimulator output.
        operator: Name of the person who has set it.
    """

    percent: float
    operator: str


class Response(msgspec.Struct, frozen=True, kw_only=True):
    """One pulse that was given, and its response.

    Attributes:
        pulse: Number of the pulse.
        intensity: Intensity, percent of the maximum stimulator output.
        coil: ``image_from_coil`` in the newest frame of the tracker before the pulse.
        error_mm: Distance of the coil from its planned pose at that time, mm.
        error_deg: Angle of the coil to its planned pose at that time, deg.
        mep: Measured response; None without a measurement.
        problem: Code of the reason why the measurement is not valid; empty if it is valid.
        problem_text: Text of that reason.
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
    """Data of a procedure with stimulation.

    The cell's time has no meaning after a restart: `last_pulse` is then unknown, and the interval counts from arming.
    It also does if the stimulator has counted pulses that this procedure has not, because their outcome was unknown.

    Attributes:
        ceiling: Greatest permitted intensity; None until the operator has set it.
        intensity: Intensity of the next pulse, percent of the maximum stimulator output; None until it has been set.
        pulse: Number of the last pulse, counted by this procedure or by the stimulator, whichever is greater.
        given: Number of pulses since the daemon started.
        last_pulse: Time of the last pulse, s of the cell's clock; None before this daemon has armed the stimulator.
        response: Response to the last pulse with a known outcome. The journal holds all of them.
        epoch: Signal of that response; None if there is none.
        search: Search for the hot-spot, active or concluded.
        search_intensity: Intensity of all pulses of the search, percent of the maximum stimulator output.
        hotspot: ``image_from_coil`` at the hot-spot; None until it is found.
        hunt: Hunt for the threshold, active or concluded.
        threshold: Motor threshold; None until it is found.
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
        """State of the stimulation for people."""
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
    """Remove the data that the joint state no longer supports. Pure.

    Args:
        data: Data of the procedure.
        states: New state of every branch.
        effects: Effects of the commit.
    """
    changes: dict[str, object] = {}
    if states["hotspot"] == "none":
        changes |= {"search": None, "search_intensity": None, "hotspot": None}
    if states["threshold"] == "none":
        changes |= {"hunt": None, "threshold": None}
    fitted = msgspec.structs.replace(data, **changes) if changes else data
    return settle_placement(fitted, states, effects)


def stimulator_of(cell: Cell) -> Stimulator:
    """Return the cell's stimulator. Raises `RefusalError` if there is none."""
    if cell.stimulator is None:
        text = "There is no stimulator: set stimulator.driver, such as sim or trigger, and restart the daemon."
        raise RefusalError("no_stimulator", text)
    return cell.stimulator


def emg_of(cell: Cell) -> Emg:
    """Return the cell's electromyograph. Raises `RefusalError` if there is none."""
    if cell.emg is None:
        text = "There is no electromyograph: set emg.driver, such as sim or lsl, and restart the daemon."
        raise RefusalError("no_emg", text)
    return cell.emg


def stimulator_there(run: Run) -> None:
    """Refuse without a stimulator."""
    stimulator_of(run.cell)


def emg_there(run: Run) -> None:
    """Refuse without an electromyograph, because nothing could be learned from the pulse."""
    emg_of(run.cell)


def register_device_checks(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks."""
    for check in (stimulator_there, emg_there):
        registry.check(check)
