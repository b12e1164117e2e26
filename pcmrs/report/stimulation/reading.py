"""Pulses, hot-spot and motor threshold of a session, read from its journal."""

from __future__ import annotations

import math
from typing import Any, Final

import msgspec

from pcmrs.analysis.session import Phase, PlacementRecord, PulseRecord, RefusalRecord, RegistrationRecord
from pcmrs.errors import JournalError
from pcmrs.messages import BlueprintTag, Epoch, PoseMessage
from pcmrs.report.session_journal import CONFIRM, JournalledOutcome, SessionJournal, operation_name, source_without_port
from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.settings import Estimate, Hotspot
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.data import Registered, as_message
from pcmrs.workflows.tms.data import Response

PHASES: Final[dict[str, Phase]] = {
    "stimulation.fire": "intensity",
    "hotspot.pulse": "hotspot",
    "threshold.pulse": "threshold",
}
"""Purpose of the pulse, by the operation that fires it."""
PLANS: Final = ("toolplan.plan", "toolplan.aim_hotspot")
"""Operations that set the planned pose."""


class StimulationSession:
    """A session with transcranial magnetic stimulation. Times are seconds of the cell since its first row.

    Args:
        journal: Rows of the session.

    Raises:
        JournalError: The journal has no rows.
    """

    def __init__(self, journal: SessionJournal) -> None:
        if not journal.rows:
            raise JournalError("The journal of the session is empty: nothing was done in it.")
        self._journal = journal
        self._first = journal.rows[0].row

    @property
    def started_at(self) -> float:
        """Time of the first row, Unix seconds."""
        return self._first.wall

    @property
    def duration(self) -> float:
        """Time from the first row to the last, s of the cell."""
        return self._onset(self._journal.rows[-1].row.monotonic)

    @property
    def workflow(self) -> BlueprintTag:
        """Workflow under which the first row was decided."""
        return self._first.blueprint

    def pulses(self) -> tuple[PulseRecord, ...]:
        """Return all pulses that are known to have been given, in order."""
        return tuple(self._pulse(outcome) for outcome in self._journal.accepted(*PHASES))

    def placements(self) -> tuple[PlacementRecord, ...]:
        """Return the measurements of the coil at its planned pose, in order."""
        found, tre = [], None
        for outcome in self._journal.accepted(*PLANS, CONFIRM):
            if outcome.name in PLANS:
                tre = outcome.result.get("tre")
            else:
                found.append(self._placement(outcome, tre))
        return tuple(found)

    def registration(self) -> RegistrationRecord | None:
        """Return the last accepted registration; None if there is none."""
        accepted = list(self._journal.accepted("registration.register"))
        if not accepted:
            return None
        result, registered = accepted[-1].result, msgspec.convert(accepted[-1].data["registered"], Registered)
        return RegistrationRecord(
            landmarks={each.name: each.position for each in registered.landmarks},
            distances_mm=tuple(1e3 * distance for distance in result.get("distances", ())),
            residual_mm=1e3 * registered.residual,
            rms_mm=1e3 * registered.rms,
            limit_mm=1e3 * result["limit"],
            tre_mm=None if result.get("tre") is None else 1e3 * result["tre"],
            tre_at=str(result.get("target", {}).get("at", "")),
        )

    def refusals(self) -> tuple[RefusalRecord, ...]:
        """Return what was not accepted, repeats in a row as one, and then the operations that have no outcome."""
        found: list[RefusalRecord] = []
        for outcome in self._journal.not_accepted():
            new = self._refusal(outcome)
            if found and _key(found[-1]) == _key(new):
                found[-1] = msgspec.structs.replace(found[-1], times=found[-1].times + 1)
            else:
                found.append(new)
        return (*found, *self._unfinished())

    def ceiling(self) -> tuple[float, str] | None:
        """Return the last ceiling of the intensity, percent, and the person who set it; None if none was set."""
        stored = self._journal.stored_data("ceiling")
        return None if stored is None else (float(stored["percent"]), str(stored["operator"]))

    def search(self) -> HotspotSearch | None:
        """Return the last state of the hot-spot search; None if there was none."""
        stored = self._journal.stored_data("search")
        return None if stored is None else msgspec.convert(stored, HotspotSearch)

    def hunt(self) -> MotorThresholdEstimator | None:
        """Return the last state of the threshold hunt; None if there was none."""
        stored = self._journal.stored_data("hunt")
        return None if stored is None else msgspec.convert(stored, MotorThresholdEstimator)

    def hotspot(self) -> Hotspot | None:
        """Return the hot-spot that the search found; None if it found none."""
        found = [
            outcome.result["hotspot"]
            for outcome in self._journal.accepted("hotspot.pulse", "hotspot.conclude")
            if "hotspot" in outcome.result
        ]
        return msgspec.convert(found[-1], Hotspot) if found else None

    def threshold(self) -> Estimate | None:
        """Return the threshold that the hunt found; None if it found none."""
        stored = self._journal.stored_data("threshold")
        return None if stored is None else msgspec.convert(stored, Estimate)

    def _onset(self, monotonic: float) -> float:
        return monotonic - self._first.monotonic

    def _pulse(self, outcome: JournalledOutcome) -> PulseRecord:
        data = outcome.data
        response = msgspec.convert(data["response"], Response)
        epoch = data.get("epoch")
        return PulseRecord(
            pulse=response.pulse,
            phase=PHASES[outcome.name],
            onset=self._onset(data["last_pulse"]),
            wall=outcome.row.wall,
            intensity=response.intensity,
            coil=response.coil,
            error_mm=response.error_mm,
            error_deg=response.error_deg,
            mep=response.mep,
            problem=response.problem,
            problem_text=response.problem_text,
            epoch=None if epoch is None else msgspec.convert(epoch, Epoch),
        )

    def _placement(self, outcome: JournalledOutcome, tre: float | None) -> PlacementRecord:
        result = outcome.result
        return PlacementRecord(
            onset=self._onset(outcome.row.monotonic),
            error_mm=1e3 * result["translation_error"],
            error_deg=math.degrees(result["rotation_error"]),
            planned=_pose(result["planned"]),
            measured=_pose(result["measured"]),
            tre_mm=None if tre is None else 1e3 * tre,
        )

    def _refusal(self, outcome: JournalledOutcome) -> RefusalRecord:
        return RefusalRecord(
            onset=self._onset(outcome.row.monotonic),
            operation=outcome.name,
            source=source_without_port(outcome.row.source),
            decision=outcome.verdict.decision,
            code=outcome.code,
            text=outcome.text,
        )

    def _unfinished(self) -> list[RefusalRecord]:
        return [
            RefusalRecord(
                onset=self._onset(stored.row.monotonic),
                operation=operation_name(stored.row),
                source=source_without_port(stored.row.source),
                decision="unknown",
                code="no_outcome",
                text="It was in progress at the last row; its outcome is unknown.",
            )
            for stored in self._journal.unfinished()
        ]


def _pose(pose: dict[str, Any]) -> PoseMessage:
    return as_message(Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"]))


def _key(refusal: RefusalRecord) -> tuple[str, ...]:
    return refusal.operation, refusal.source, refusal.decision, refusal.code
