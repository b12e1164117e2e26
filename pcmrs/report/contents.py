"""What a report says, as plain data."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.messages import BlueprintTag, PoseMessage

Decision = Literal["accepted", "rejected", "failed", "unknown"]
EventKind = Literal["stop", "fault", "notice"]
"""Somebody stopped everything; a device or the daemon reported a danger; it reported something else."""


class ReportedRun(msgspec.Struct, frozen=True, kw_only=True):
    """One run of the daemon.

    Attributes:
        session: Its id in the journal.
        begun: Unix seconds of its first row.
        ended: Unix seconds of its last row.
        in_order: Whether it was ended; not, where it was killed or went on when the journal was read.
        patient: Of its settings.
        first: Sequence of its first row.
        last: Sequence of its last row.
    """

    session: str
    begun: float
    ended: float
    in_order: bool
    patient: str
    first: int
    last: int


class ReportedGate(msgspec.Struct, frozen=True, kw_only=True):
    """One test of a registration; its unit depends on its name, lengths are in m."""

    name: str
    accepted: bool
    value: float
    limit: float


class ReportedLandmark(msgspec.Struct, frozen=True, kw_only=True):
    """A landmark of a registration, and how far from its place it is after the fit."""

    name: str
    distance_mm: float


class ReportedRegistration(msgspec.Struct, frozen=True, kw_only=True):
    """A registration that was put in force.

    Attributes:
        sequence: Of its row.
        wall: Unix seconds.
        operation: That did it: ``register``, ``refine``, ``use_previous``.
        residual_mm: Mean distance of the landmarks.
        residual_limit_mm: Of that; None where the journal does not say.
        tre_mm: Target registration error predicted at `target`, rms.
        target: ``plan`` or ``centroid``.
        id: In the journal.
    """

    sequence: int
    wall: float
    operation: str
    residual_mm: float | None
    rms_mm: float | None
    residual_limit_mm: float | None
    tre_mm: float | None
    tre_limit_mm: float | None
    target: str
    landmarks: tuple[ReportedLandmark, ...]
    gates: tuple[ReportedGate, ...]
    id: str


class ReportedPlan(msgspec.Struct, frozen=True, kw_only=True):
    """A planned pose, and the target registration error predicted there, rms."""

    sequence: int
    wall: float
    operation: str
    tre_mm: float | None


class ReportedPlacement(msgspec.Struct, frozen=True, kw_only=True):
    """The tool as the tracker measured it, against the pose that was planned.

    Attributes:
        operation: That measured it, such as ``placement.confirm``.
        error_mm: As the journal has it.
        error_deg: The same of the rotation.
        axes_mm: Of the translation, in the measured tool's axes; None where the poses are not on record.
        planned: ``image_from_tool``; None likewise.
        measured: ``image_from_tool``; None likewise.
        standoff: How far along the tool's z axis it was to end before the planned pose, m.
    """

    sequence: int
    wall: float
    operation: str
    error_mm: float
    error_deg: float
    axes_mm: tuple[float, float, float] | None
    planned: PoseMessage | None
    measured: PoseMessage | None
    standoff: float


class AcceptedOperation(msgspec.Struct, frozen=True, kw_only=True):
    """An operation, and how often it was accepted.

    Attributes:
        title: What it does, as its workflow calls it.
        acts: Whether it acts on the patient without moving the robot; None where the workflow is not known here.
    """

    operation: str
    title: str
    times: int
    acts: bool | None


class ReportedRefusal(msgspec.Struct, frozen=True, kw_only=True):
    """What was not accepted, for one reason.

    Attributes:
        sequence: Row of the first time.
        wall: Unix seconds of the first time.
        times: How often in all.
        checked: A check has looked at arguments, data or the world; otherwise it was asked for at a wrong time or by
            the wrong one.
        advice: What to do.
    """

    sequence: int
    wall: float
    operation: str
    who: str
    decision: Decision
    code: str
    text: str
    advice: str
    checked: bool
    times: int


class UnknownOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """An operation that has begun, and nobody knows how it ended.

    Attributes:
        wall: Unix seconds at which it was found.
        settled: Whether an operator has looked since; None where the workflow is not known here.
    """

    sequence: int
    wall: float
    operation: str
    text: str
    settled: bool | None


class ReportedEvent(msgspec.Struct, frozen=True, kw_only=True):
    """What a device or the daemon reported by itself; `times` in a row."""

    sequence: int
    wall: float
    kind: EventKind
    source: str
    code: str
    text: str
    times: int


class TimelineEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A line of the timeline.

    Attributes:
        what: Operation or event.
        outcome: Decision, or kind of the event.
        state: Of the branch afterwards; empty for events.
        text: Reason or what was reported.
        times: In a row.
    """

    sequence: int
    wall: float
    what: str
    who: str
    outcome: str
    state: str
    text: str
    times: int


class StateSpan(msgspec.Struct, frozen=True, kw_only=True):
    """A state of a branch, from when to when, Unix seconds."""

    state: str
    begun: float
    ended: float


class ReportedBranch(msgspec.Struct, frozen=True, kw_only=True):
    """A branch of the workflow and its states over time.

    Attributes:
        states: State to what it means, as far as that is known here.
        final: In which it was at last.
    """

    name: str
    title: str
    states: dict[str, str]
    spans: tuple[StateSpan, ...]
    final: str


class ReportedJournal(msgspec.Struct, frozen=True, kw_only=True):
    """How good the journal is.

    Attributes:
        name: Of its file.
        rows: That could be read, from the first on.
        problems: What is not as it must be; empty where it verified itself.
        proven: So many rows are proven by its signature.
        last_hash: Of the last row, hexadecimal.
        key: SHA-256 of the public key's file; empty where there is none.
    """

    name: str
    rows: int
    problems: tuple[str, ...]
    signature: str
    proven: int
    last_hash: str
    key: str


class ReportedFile(msgspec.Struct, frozen=True, kw_only=True):
    """A file that the session has left.

    Attributes:
        note: What is not as it should be; empty where nothing is known to be.
        wrong: Whether it is missing, or not as it was exported.
    """

    name: str
    size: int
    sha256: str
    note: str
    wrong: bool = False


class SessionReport(msgspec.Struct, frozen=True, kw_only=True):
    """One session.

    Attributes:
        patient: Its id; empty where nobody said.
        operator: The same.
        named: Who is named in commands as having done something, such as the surgeon.
        asked: Who has asked for operations, with their roles.
        title: Of the workflow.
        known: Whether that very workflow is installed here; otherwise titles and meanings are missing.
        devices: Device to its driver.
        rate: Seconds of the cell per second of the machine; None where the journal does not say.
        earlier: Sessions in the journal before this one.
        later: Sessions in it after this one.
        asked_for: How many operations were asked for in all.
        counts: Decision to how many ended so.
        latched: Whether a Stop was still latched at the end; None where the workflow is not known here.
        changed: Settings that are not the defaults of this version.
    """

    patient: str
    operator: str
    named: tuple[str, ...]
    asked: tuple[str, ...]
    workflow: BlueprintTag
    title: str
    known: bool
    devices: dict[str, str]
    rate: float | None
    begun: float
    ended: float
    runs: tuple[ReportedRun, ...]
    earlier: int
    later: int
    journal: ReportedJournal
    asked_for: int
    counts: dict[str, int]
    registrations: tuple[ReportedRegistration, ...]
    plans: tuple[ReportedPlan, ...]
    placements: tuple[ReportedPlacement, ...]
    done: tuple[AcceptedOperation, ...]
    refusals: tuple[ReportedRefusal, ...]
    unknown: tuple[UnknownOutcome, ...]
    events: tuple[ReportedEvent, ...]
    latched: bool | None
    branches: tuple[ReportedBranch, ...]
    timeline: tuple[TimelineEntry, ...]
    calibration: str
    versions: dict[str, str]
    reported_by: str
    changed: tuple[str, ...]
    files: tuple[ReportedFile, ...]

    @property
    def simulated(self) -> bool:
        """True if all drivers are those of the simulation."""
        return bool(self.devices) and set(self.devices.values()) == {"sim"}

    @property
    def problems(self) -> tuple[str, ...]:
        """What is not as it was written: of the journal, and of the files."""
        return (*self.journal.problems, *(f"{file.name} {file.note}." for file in self.files if file.wrong))

    def events_of(self, kind: EventKind) -> tuple[ReportedEvent, ...]:
        """Those of one kind."""
        return tuple(event for event in self.events if event.kind == kind)
