"""A simulated cell whose stimulator is the subject."""

from __future__ import annotations

from pcmrs.clock import Clock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.settings import SimSettings, StimulatorSettings
from pcmrs_sim.stimulator import SimStimulator


def make_cell(clock: Clock, **settings: float) -> CellSimulation:
    return CellSimulation(
        SimSettings(stimulator=StimulatorSettings(**settings)), ARMS["iiwa14"], ForceSettings(), clock
    )


def stimulator_of(cell: CellSimulation) -> SimStimulator:
    stimulator = cell.devices["stimulator"]
    assert isinstance(stimulator, SimStimulator)
    return stimulator
