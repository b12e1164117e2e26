"""What the journal says of a session; nothing is taken from anywhere else but the truth of a simulation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec

from pcmrs.analysis.session import (
    Phase,
    PlacementRecord,
    PulseRecord,
    RefusalRecord,
    RegistrationRecord,
)
from pcmrs.errors import JournalError
from pcmrs.journal import JournalReader
from pcmrs.journal.rows import JournalRow
from pcmrs.messages import BlueprintTag, Epoch, Verdict
from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.settings import Estimate, Hotspot
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.data import Registered, as_message
from pcmrs.workflows.tms.data import Response

PHASES: dict[str, Phase] = {
    "stimulation.fire": "intensity",
    "hotspot.pulse": "hotspot",
    "threshold.pulse": "threshold",
}
"""What an operation that fires is for."""
PLANS = ("toolplan.plan", "toolplan.aim_hotspot")


@dataclass(frozen=True)
class Journalled:
    """The rows of one session's journal, in order.

    Raises:
        JournalError: There are none.
    """

    rows: tuple[JournalRow, ...]

    def __post_init__(self) -> None:
        if not self.rows:
            raise JournalError("The journal of the session is empty: nothing was done in it.")

    @classmethod
    def read(cls, reader: JournalReader) -> Journalled:
        """All rows of a journal. Raises `JournalError`."""
        return cls(tuple(stored.row for stored in reader.read()))

    @property
    def begun(self) -> float:
        """Unix seconds."""
        return self.rows[0].wall

    @property
    def duration(self) -> float:
        """From the first row to the last, s of the cell."""
        return self.onset(self.rows[-1].monotonic)

    @property
    def workflow(self) -> BlueprintTag:
        """Under which it was decided."""
        return self.rows[0].blueprint

    def onset(self, monotonic: float) -> float:
        """A time of the cell's clock, since the session began, s."""
        return monotonic - self.rows[0].monotonic

    def pulses(self) -> tuple[PulseRecord, ...]:
        """All pulses that are known to have been given, in order."""
        return tuple(self._pulse(row) for row in self._accepted(PHASES))

    def placements(self) -> tuple[PlacementRecord, ...]:
        """Every time that the coil was brought to its planned pose."""
        found, tre = [], None
        for row in self._accepted((*PLANS, "placement.confirm")):
            told = _told(row)
            if _name(row) in PLANS:
                tre = told.get("tre")
            else:
                found.append(self._placement(row, told, tre))
        return tuple(found)

    def registration(self) -> RegistrationRecord | None:
        """The last one accepted."""
        rows = list(self._accepted(("registration.register",)))
        if not rows:
            return None
        told, registered = _told(rows[-1]), msgspec.convert((rows[-1].result or {})["registered"], Registered)
        return RegistrationRecord(
            landmarks={each.name: each.position for each in registered.landmarks},
            distances_mm=tuple(1e3 * distance for distance in told.get("distances", ())),
            residual_mm=1e3 * registered.residual,
            rms_mm=1e3 * registered.rms,
            limit_mm=1e3 * told["limit"],
            tre_mm=None if told.get("tre") is None else 1e3 * told["tre"],
            tre_at=str(told.get("target", {}).get("at", "")),
        )

    def refusals(self) -> tuple[RefusalRecord, ...]:
        """Everything that was not accepted, each with its reason; and what had begun when the record ended."""
        found: list[RefusalRecord] = []
        for row in self.rows:
            if row.kind != "outcome" or row.verdict is None or row.verdict.decision == "accepted":
                continue
            new = self._refusal(row, row.verdict)
            same = found and _key(found[-1]) == _key(new)
            found[-1:] = [msgspec.structs.replace(found[-1], times=found[-1].times + 1)] if same else [*found[-1:], new]
        return (*found, *(self._unfinished(row) for row in self._open_intents()))

    def ceiling(self) -> tuple[float, str] | None:
        """The last one set, percent, and by whom."""
        kept = self._last("ceiling")
        return None if kept is None else (float(kept["percent"]), str(kept["operator"]))

    def search(self) -> HotspotSearch | None:
        """As it stood in the end."""
        kept = self._last("search")
        return None if kept is None else msgspec.convert(kept, HotspotSearch)

    def hunt(self) -> MotorThresholdEstimator | None:
        """As it stood in the end."""
        kept = self._last("hunt")
        return None if kept is None else msgspec.convert(kept, MotorThresholdEstimator)

    def hotspot(self) -> Hotspot | None:
        """Where the search found it."""
        told = [
            _told(row)["hotspot"]
            for row in self._accepted(("hotspot.pulse", "hotspot.conclude"))
            if "hotspot" in _told(row)
        ]
        return msgspec.convert(told[-1], Hotspot) if told else None

    def threshold(self) -> Estimate | None:
        """What the hunt found."""
        kept = self._last("threshold")
        return None if kept is None else msgspec.convert(kept, Estimate)

    def _pulse(self, row: JournalRow) -> PulseRecord:
        kept = row.result or {}
        response = msgspec.convert(kept["response"], Response)
        epoch = kept.get("epoch")
        return PulseRecord(
            pulse=response.pulse,
            phase=PHASES[_name(row)],
            onset=self.onset(kept["last_pulse"]),
            wall=row.wall,
            intensity=response.intensity,
            coil=response.coil,
            error_mm=response.error_mm,
            error_deg=response.error_deg,
            mep=response.mep,
            problem=response.problem,
            problem_text=response.problem_text,
            epoch=None if epoch is None else msgspec.convert(epoch, Epoch),
        )

    def _placement(self, row: JournalRow, told: dict[str, Any], tre: float | None) -> PlacementRecord:
        planned, measured = (
            as_message(Transform.from_quat_xyzw(told[pose]["position"], told[pose]["quat_xyzw"]))
            for pose in ("planned", "measured")
        )
        return PlacementRecord(
            onset=self.onset(row.monotonic),
            error_mm=1e3 * told["translation_error"],
            error_deg=math.degrees(told["rotation_error"]),
            planned=planned,
            measured=measured,
            tre_mm=None if tre is None else 1e3 * tre,
        )

    def _refusal(self, row: JournalRow, verdict: Verdict) -> RefusalRecord:
        return RefusalRecord(
            onset=self.onset(row.monotonic),
            operation=_name(row),
            source=_source(row.source),
            decision=verdict.decision,
            code="" if verdict.reason is None else verdict.reason.code,
            text="" if verdict.reason is None else verdict.reason.text,
        )

    def _unfinished(self, row: JournalRow) -> RefusalRecord:
        return RefusalRecord(
            onset=self.onset(row.monotonic),
            operation=_name(row),
            source=_source(row.source),
            decision="unknown",
            code="no_outcome",
            text="It had begun when the record ended; nobody knows how it ended.",
        )

    def _open_intents(self) -> list[JournalRow]:
        ended = {(row.source, row.command_id) for row in self.rows if row.kind == "outcome"}
        return [row for row in self.rows if row.kind == "intent" and (row.source, row.command_id) not in ended]

    def _accepted(self, names: Iterable[str]) -> Iterator[JournalRow]:
        wanted = set(names)
        for row in self.rows:
            accepted = row.kind == "outcome" and row.verdict is not None and row.verdict.decision == "accepted"
            if accepted and _name(row) in wanted:
                yield row

    def _last(self, field: str) -> Any:
        """What was last kept of the procedure's data under a name; None where nothing was, or it was taken back."""
        return next((row.result[field] for row in reversed(self.rows) if row.result and field in row.result), None)


def _told(row: JournalRow) -> dict[str, Any]:
    return (row.verdict.result if row.verdict is not None else None) or {}


def _name(row: JournalRow) -> str:
    return f"{row.branch}.{row.operation}"


def _source(source: str | None) -> str:
    """Who asked, without the port, which says nothing."""
    return ":".join((source or "").split(":")[:2])


def _key(refusal: RefusalRecord) -> tuple[str, ...]:
    return refusal.operation, refusal.source, refusal.decision, refusal.code
