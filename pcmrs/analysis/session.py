"""Data of a session with stimulation, from which its tables, figures and report are made."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.messages import BlueprintTag, Epoch, PoseMessage
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.mep import Mep
from pcmrs.tms.settings import Estimate, Hotspot, MepSettings
from pcmrs.tms.threshold import MotorThresholdEstimator

__all__ = ["Phase", "PlacementRecord", "PulseRecord", "RefusalRecord", "RegistrationRecord", "SessionRecord"]

Phase = Literal["intensity", "hotspot", "threshold"]
"""Purpose of a pulse: to find an intensity for the search, the hot-spot search, the threshold hunt."""

Point = tuple[float, float, float]


class PulseRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One pulse that was given.

    Attributes:
        onset: Time since the start of the session, s of the cell.
        wall: Time of its journal row, Unix seconds.
        intensity: Intensity, percent of the maximum stimulator output.
        coil: ``image_from_coil``, measured by the tracker right before the pulse.
        error_mm: Distance of the coil from its planned pose then.
        error_deg: Angle of the coil from its planned pose then.
        mep: Measured response; None if there is no measurement.
        problem: Code of the reason why it does not count; empty if it counts.
        problem_text: Text of that reason.
        epoch: Signal; None if there is none.
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
    """A measurement of the coil at its planned pose.

    Attributes:
        onset: Time since the start of the session, s of the cell.
        planned: Planned ``image_from_coil``.
        measured: Measured ``image_from_coil``.
        tre_mm: Target registration error predicted there, rms; None if the plan has none.
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
        landmarks: Name and planned point in the image, m, of each landmark, in order.
        distances_mm: Distance of each landmark from its planned point after the fit.
        tre_mm: Target registration error predicted at `tre_at`, rms.
    """

    landmarks: dict[str, Point]
    distances_mm: tuple[float, ...]
    residual_mm: float
    rms_mm: float
    limit_mm: float
    tre_mm: float | None = None
    tre_at: str = ""


class RefusalRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A command that was not accepted, `times` in a row for the same reason.

    Attributes:
        onset: Time of the first one since the start of the session, s of the cell.
        decision: ``rejected``, ``failed`` or ``unknown``.
        text: Reason of the first one.
    """

    onset: float
    operation: str
    source: str
    decision: str
    code: str
    text: str
    times: int = 1


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """The truth of a simulation, for the report alone.

    Attributes:
        hotspot: ``image_from_coil`` at the true hot-spot.
        threshold: True threshold there, percent of the maximum stimulator output.
        threshold_here: True threshold at the pose where it was hunted, percent; None if there was no hunt.
    """

    hotspot: PoseMessage
    threshold: float
    threshold_here: float | None = None


class SessionRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One session.

    Attributes:
        subject: Id of the subject.
        seed: Seed of the simulation; None if it was not simulated.
        rate: Seconds of the cell per second of the machine.
        begun: Start, Unix seconds.
        duration: Time until the last row of the journal, s of the cell.
        settings: Settings that differ from the default configuration.
        versions: Versions of the programs, by name.
        ended: Reason why it ended early; empty if it is complete.
        ceiling: Highest allowed intensity, percent, and the person who set it; None if none was set.
        mep_settings: Settings by which the responses were judged.
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
        """True if the session was simulated."""
        return self.seed is not None

    def of_phase(self, phase: Phase) -> tuple[PulseRecord, ...]:
        """Return the pulses of one purpose."""
        return tuple(pulse for pulse in self.pulses if pulse.phase == phase)
