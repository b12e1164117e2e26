"""What a session with stimulation has left on record: what its tables, pictures and report are made from."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.messages import BlueprintTag, Epoch, PoseMessage
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.mep import Mep
from pcmrs.tms.settings import Estimate, Hotspot, MepSettings
from pcmrs.tms.threshold import MotorThresholdEstimator

Phase = Literal["intensity", "hotspot", "threshold"]
"""What a pulse was given for: to find an intensity for the search, in the search, in the hunt."""

Point = tuple[float, float, float]


class PulseRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One pulse that was given.

    Attributes:
        onset: Since the session began, s of the cell.
        wall: Unix seconds at which it was on record.
        intensity: Percent of the maximum stimulator output.
        coil: ``image_from_coil`` as the tracker saw it right before.
        error_mm: Of the coil against its planned pose then.
        error_deg: The same for its rotation.
        mep: What was measured; None where there is no measurement.
        problem: Code of why it says nothing about the muscle; empty where it counts.
        problem_text: The same for people.
        epoch: The signal; None where there is none.
    """

    pulse: int
    phase: Phase
    onset: float
    wall: float
    intensity: float
    coil: PoseMessage
    error_mm: float
    error_deg: float
    mep: Mep | None = None
    problem: str = ""
    problem_text: str = ""
    epoch: Epoch | None = None


class PlacementRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The coil, as the tracker measured it at its planned pose.

    Attributes:
        tre_mm: Error of the registration predicted there, rms; None where the plan was made without one.
        planned: ``image_from_coil``.
    """

    onset: float
    error_mm: float
    error_deg: float
    planned: PoseMessage
    measured: PoseMessage
    tre_mm: float | None = None


class RegistrationRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The registration in force.

    Attributes:
        landmarks: Name and place in the image, m, of each, in order.
        distances_mm: That they are from where they were planned, after the fit.
        tre_mm: Predicted error at `tre_at`, rms.
    """

    landmarks: dict[str, Point]
    distances_mm: tuple[float, ...]
    residual_mm: float
    rms_mm: float
    limit_mm: float
    tre_mm: float | None = None
    tre_at: str = ""


class RefusalRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A command that was not accepted, as often in a row as it was not for one reason.

    Attributes:
        onset: The first time.
        decision: ``rejected``, ``failed`` or ``unknown``.
        text: Of the first time.
    """

    onset: float
    operation: str
    source: str
    decision: str
    code: str
    text: str
    times: int = 1


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """What only a simulation knows; for the report alone.

    Attributes:
        hotspot: ``image_from_coil`` at the true hot-spot.
        threshold: There, percent of the maximum stimulator output.
        threshold_here: The same at the pose where the threshold was hunted; None where none was.
    """

    hotspot: PoseMessage
    threshold: float
    threshold_here: float | None = None


class SessionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One session.

    Attributes:
        subject: Whose it is.
        seed: Of the simulation; None where it was none.
        rate: Seconds of the cell per second of the machine.
        begun: Unix seconds.
        duration: Until the last entry of the journal, s of the cell.
        settings: What differed from the default configuration.
        versions: Of what it was made with, by name.
        ended: Why it ended early; empty where it is complete.
        ceiling: Highest intensity that was allowed, percent, and by whom; None where none was set.
        mep_settings: That the responses were judged by.
    """

    subject: str
    seed: int | None
    rate: float
    begun: float
    duration: float
    workflow: BlueprintTag
    settings: tuple[str, ...]
    versions: dict[str, str]
    mep_settings: MepSettings
    ended: str = ""
    ceiling: tuple[float, str] | None = None
    registration: RegistrationRecord | None = None
    placements: tuple[PlacementRecord, ...] = ()
    pulses: tuple[PulseRecord, ...] = ()
    refusals: tuple[RefusalRecord, ...] = ()
    search: HotspotSearch | None = None
    hotspot: Hotspot | None = None
    hunt: MotorThresholdEstimator | None = None
    threshold: Estimate | None = None
    truth: Truth | None = None

    @property
    def simulated(self) -> bool:
        """True if any of it was simulated."""
        return self.seed is not None

    def of_phase(self, phase: Phase) -> tuple[PulseRecord, ...]:
        """The pulses that were given for one purpose."""
        return tuple(pulse for pulse in self.pulses if pulse.phase == phase)
