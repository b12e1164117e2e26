"""The contents of a session's report, read from its journal."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from pcmrs.analysis.placements import placement_error
from pcmrs.config import as_table
from pcmrs.dispatcher.events import SHUTDOWN
from pcmrs.errors import BlueprintError, ConfigurationError, JournalError, PcmrsError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import PoseMessage
from pcmrs.report._advice import WRONG_TIME, advise
from pcmrs.report._contents import (
    AcceptedOperation,
    EventKind,
    ReportedBranch,
    ReportedEvent,
    ReportedGate,
    ReportedLandmark,
    ReportedPlacement,
    ReportedPlan,
    ReportedRefusal,
    ReportedRegistration,
    ReportedRun,
    ReportedUnknownOutcome,
    SessionReport,
    StateSpan,
    TimelineEntry,
)
from pcmrs.report.session_journal import (
    SessionJournal,
    configured_calibrations,
    find_session,
    operation_name,
    source_without_port,
)
from pcmrs.report.source import ReportSource, files_of, open_source
from pcmrs.service.restart.state import PersistedState, RestartState
from pcmrs.settings import DEVICES, read_settings
from pcmrs.spatial import Transform
from pcmrs.workflows import find_workflow
from pcmrs.workflows.data import Registered, as_message, as_transform

__all__ = ["SessionReport", "read_report"]

LONGEST_PAUSE: Final = 3600.0
"""Largest pause, s, after which a run continues the session of one of the same patient that did not end in order."""
ROUTINE: Final = frozenset({"activity_started", "activity_ended", "timer_started", "timer_ended"})
"""Codes of events that are routine."""
STOPPED: Final = "stopped"
"""Code of a requested Stop."""
SAME_EVENT: Final = 1.0
"""Time within which repeated events count as one, s: a client sends Stop on more than one link."""
PERSON_ARGUMENTS: Final = ("surgeon", "operator")
"""Arguments in which a command names a person."""


def read_report(path: Path, session: str | None = None) -> SessionReport:
    """Return the contents of a report.

    Args:
        path: Folder of an exported session, folder of a cell, or journal file.
        session: Start of the session's id; None for the exported session, or else the last one.

    Raises:
        JournalError: Nothing can be read, there is no such session, or a row holds values that this program never
            writes.
    """
    source = open_source(path)
    try:
        # The configuration's values are unchecked until here; the page relies on their types.
        return msgspec.convert(msgspec.to_builtins(_report(source, session)), SessionReport)
    except PcmrsError:
        raise
    except Exception as error:  # a row of another program may have a wrong type anywhere
        what = f"{type(error).__name__}: {error}"
        text = f"{source.path} cannot be reported: a row holds a value that this program never writes ({what})."
        raise JournalError(text, path=str(source.path)) from error


def _report(source: ReportSource, session: str | None) -> SessionReport:
    runs = _runs(source.rows)
    first, last = _runs_of_session(runs, session if session is not None else source.exported, source.path)
    chosen = runs[first : last + 1]
    rows = [stored for stored in source.rows if chosen[0].first <= stored.sequence <= chosen[-1].last]
    final = rows[-1].row
    started = [stored.row.result or {} for stored in rows if stored.row.kind == "config"]
    config = started[-1] if started else {}
    settings = config.get("settings", {})
    procedure = settings.get("procedure", {})
    blueprint = _blueprint(final, settings)
    restored = None if blueprint is None else _RestoredState(source.rows, chosen[-1].last, blueprint)
    journal = SessionJournal(rows)
    view = _ReportView(journal, procedure, blueprint)
    return SessionReport(
        patient=str(procedure.get("patient", "")),
        operator=str(procedure.get("operator", "")),
        named=view.named(),
        asked=view.asked(),
        workflow=final.blueprint,
        title=final.blueprint.id if blueprint is None else blueprint.title,
        known=blueprint is not None,
        devices={name: driver for name in DEVICES if name != "scene" and (driver := _driver(settings, name))},
        rate=settings.get("cell", {}).get("rate"),
        begun=chosen[0].begun,
        ended=chosen[-1].ended,
        runs=tuple(chosen),
        earlier=first,
        later=len(runs) - 1 - last,
        journal=source.journal,
        asked_for=len(journal.outcomes),
        counts=view.counts(),
        registrations=tuple(view.registrations()),
        plans=tuple(view.plans()),
        placements=tuple(view.placements()),
        done=view.done(),
        refusals=view.refusals(),
        unknown=tuple(view.unknown(restored)),
        events=tuple(view.events()),
        latched=None if restored is None else restored.latched,
        branches=tuple(view.branches()),
        timeline=tuple(_merged(view.timeline(chosen))),
        calibration=str(config.get("calibration", "")),
        versions={str(name): str(value) for name, value in config.get("versions", {}).items()},
        reported_by=version("pcmrs"),
        changed=_changed(settings),
        files=files_of(source, [run.session for run in chosen], configured_calibrations(settings)),
    )


class _RestoredState:
    """Unknown outcomes and latch at the end of a session, as the daemon would restore them."""

    def __init__(self, rows: Iterable[StoredRow], last: int, blueprint: Blueprint) -> None:
        restart_state = RestartState(blueprint, PersistedState())
        for stored in rows:
            if stored.sequence <= last:
                restart_state.take(stored.row)
        state = restart_state.kept
        self.latched = state.latched
        # The state holds only the newest outcome of an operation: while that is unsettled, so are the earlier ones.
        self.unsettled = {f"{each.branch}.{each.operation}" for each in (*state.unknown, *state.begun, *state.moving)}


class _ReportView:
    """The parts of a report, from the rows of one session.

    Args:
        journal: Rows of the session.
        procedure: Procedure settings of the session, as plain data.
        blueprint: Workflow; None if it is not installed here.
    """

    def __init__(self, journal: SessionJournal, procedure: Mapping[str, Any], blueprint: Blueprint | None) -> None:
        self._journal = journal
        self._procedure = procedure
        self._blueprint = blueprint

    def counts(self) -> dict[str, int]:
        """Return the number of operations by decision."""
        return dict(Counter(outcome.verdict.decision for outcome in self._journal.outcomes))

    def asked(self) -> tuple[str, ...]:
        """Return the users who asked for operations, with their roles, in the order of their first."""
        rows = [each.row for each in self._journal.outcomes if each.row.user and each.row.role != "daemon"]
        return tuple(dict.fromkeys(f"{row.user} ({row.role or 'role unknown'})" for row in rows))

    def named(self) -> tuple[str, ...]:
        """Return the persons whom accepted commands name, with their roles."""
        given = [outcome.row.arguments or {} for outcome in self._journal.accepted()]
        names = [
            f"{arguments[role]} ({role})" for arguments in given for role in PERSON_ARGUMENTS if arguments.get(role)
        ]
        return tuple(dict.fromkeys(names))

    def registrations(self) -> Iterator[ReportedRegistration]:
        """Yield the registrations that were put in force."""
        limits = self._procedure.get("registration", {})
        for outcome in self._journal.accepted():
            stored, result = outcome.data.get("registered"), outcome.result
            if not stored:
                continue
            judged = result.get("landmarks") if isinstance(result.get("landmarks"), dict) else result
            gates = tuple(msgspec.convert(gate, ReportedGate) for gate in (judged or {}).get("gates", ()))
            by_name = {gate.name: gate.limit for gate in gates}
            registered = _registered(stored)
            yield ReportedRegistration(
                sequence=outcome.sequence,
                wall=outcome.row.wall,
                operation=outcome.name,
                residual_mm=_mm(stored.get("residual")),
                rms_mm=_mm(stored.get("rms")),
                residual_limit_mm=_mm(by_name.get("residual_too_large")) or limits.get("residual_limit_mm"),
                tre_mm=_mm(result.get("tre")),
                tre_limit_mm=_mm(by_name.get("tre_too_large")) or limits.get("tre_limit_mm"),
                target=str((result.get("target") or {}).get("at", "")),
                landmarks=() if registered is None else tuple(_landmarks(registered)),
                gates=gates,
                id=str(stored.get("id", "")),
            )

    def plans(self) -> Iterator[ReportedPlan]:
        """Yield the planned poses that were put in force."""
        for outcome in self._journal.accepted():
            if outcome.data.get("plan"):
                tre = _mm(outcome.result.get("tre"))
                yield ReportedPlan(sequence=outcome.sequence, wall=outcome.row.wall, operation=outcome.name, tre_mm=tre)

    def placements(self) -> Iterator[ReportedPlacement]:
        """Yield the measurements of the tool against its planned pose."""
        for outcome in self._journal.accepted():
            result = outcome.result
            if "planned" not in result or "translation_error" not in result or "rotation_error" not in result:
                continue
            standoff = float(result.get("confirm_offset", 0.0))
            planned, measured = _message(outcome.pose("planned")), _message(outcome.pose("measured"))
            axes = None
            if planned is not None and measured is not None:
                # From the poses as they are reported, so that a reader can compute the same numbers from them.
                error = placement_error(as_transform(planned), as_transform(measured), standoff)
                x, y, z = (1e3 * error.vector).tolist()
                axes = (x, y, z)
            yield ReportedPlacement(
                sequence=outcome.sequence,
                wall=outcome.row.wall,
                operation=outcome.name,
                error_mm=1e3 * result["translation_error"],
                error_deg=math.degrees(result["rotation_error"]),
                axes_mm=axes,
                planned=planned,
                measured=measured,
                standoff=standoff,
            )

    def done(self) -> tuple[AcceptedOperation, ...]:
        """Return the accepted operations, in the order of their first time."""
        times = Counter(outcome.name for outcome in self._journal.accepted())
        return tuple(
            AcceptedOperation(operation=name, title=self._title(name), times=count, acts=self._acts(name))
            for name, count in times.items()
        )

    def refusals(self) -> tuple[ReportedRefusal, ...]:
        """Return what was not accepted; an operation with the same reason is one entry."""
        found: dict[tuple[str, ...], ReportedRefusal] = {}
        for outcome in self._journal.not_accepted():
            key = (outcome.name, outcome.verdict.decision, outcome.code, outcome.text)
            if key in found:
                found[key] = msgspec.structs.replace(found[key], times=found[key].times + 1)
                continue
            found[key] = ReportedRefusal(
                sequence=outcome.sequence,
                wall=outcome.row.wall,
                operation=outcome.name,
                who=_who(outcome.row),
                decision=outcome.verdict.decision,
                code=outcome.code,
                text=outcome.text,
                advice=advise(outcome.verdict, self._blueprint),
                checked=outcome.code not in WRONG_TIME and outcome.code != "bad_arguments",
                times=1,
            )
        return tuple(found.values())

    def unknown(self, restored: _RestoredState | None) -> list[ReportedUnknownOutcome]:
        """Return the operations whose end is unknown, among them those without an outcome, in order of their rows.

        Args:
            restored: State that a daemon would restore after the session; None if the workflow is not installed.
        """
        texts = [
            (stored, "It was in progress when the session ended unexpectedly.") for stored in self._journal.unfinished()
        ]
        ended = [outcome for outcome in self._journal.not_accepted() if outcome.verdict.decision == "unknown"]
        rows = [(stored.sequence, stored.row, text) for stored, text in texts]
        rows += [(outcome.sequence, outcome.row, outcome.text) for outcome in ended]
        return [
            ReportedUnknownOutcome(
                sequence=sequence,
                wall=row.wall,
                operation=operation_name(row),
                text=text,
                settled=None if restored is None else operation_name(row) not in restored.unsettled,
            )
            for sequence, row, text in sorted(rows, key=lambda each: each[0])
        ]

    def events(self) -> Iterator[ReportedEvent]:
        """Yield the events of devices and daemon except routine ones; repeats in a row are one event."""
        found: list[ReportedEvent] = []
        for stored in self._journal.rows:
            kind = _event_kind(stored.row)
            if kind is None:
                continue
            event = ReportedEvent(
                sequence=stored.sequence,
                wall=stored.row.wall,
                kind=kind,
                source=stored.row.source or "",
                code=stored.row.operation or "",
                text=str((stored.row.result or {}).get("text", "")),
                times=1,
            )
            if found and _is_same(found[-1], event):
                found[-1] = msgspec.structs.replace(found[-1], times=found[-1].times + 1)
            else:
                found.append(event)
        yield from found

    def branches(self) -> Iterator[ReportedBranch]:
        """Yield each branch with its states over time."""
        moments = [(stored.row.wall, stored.row.states) for stored in self._journal.rows if _is_committed(stored.row)]
        end = self._journal.rows[-1].row.wall
        names = dict.fromkeys(name for _, states in moments for name in states or {})
        for name in names:
            walls = [(wall, states[name]) for wall, states in moments if states and name in states]
            changes = [next(group) for _, group in itertools.groupby(walls, key=lambda each: each[1])]
            ends = [*(wall for wall, _ in changes[1:]), end]
            spec = None if self._blueprint is None else self._blueprint.branches.get(name)
            yield ReportedBranch(
                name=name,
                title=name if spec is None else spec.title or name,
                states={} if spec is None else dict(spec.states),
                spans=tuple(
                    StateSpan(state=state, begun=wall, ended=until)
                    for (wall, state), until in zip(changes, ends, strict=True)
                ),
                final=changes[-1][1],
            )

    def timeline(self, runs: Sequence[ReportedRun]) -> Iterator[TimelineEntry]:
        """Yield the starts of runs, the outcomes except rejections, and the events, in order.

        Args:
            runs: Runs of the session.
        """
        starts = {run.first: run for run in runs}
        for stored in self._journal.rows:
            row = stored.row
            if stored.sequence in starts:
                run = f"session {starts[stored.sequence].session}"
                yield _entry(stored, what="The daemon started", outcome="run", text=run)
            kind = _event_kind(row)
            if kind is not None:
                text = str((row.result or {}).get("text", ""))
                yield _entry(stored, what=row.operation or "", outcome=kind, text=text)
            elif row.kind == "outcome" and row.verdict is not None and row.verdict.decision != "rejected":
                reason = row.verdict.reason
                text = "" if reason is None else reason.text
                yield _entry(
                    stored, what=operation_name(row), outcome=row.verdict.decision, text=text, state=row.verdict.state
                )
            elif row.source == SHUTDOWN:
                yield _entry(stored, what="The daemon ended in order", outcome="run", text="")

    def _title(self, name: str) -> str:
        branch, _, operation = name.partition(".")
        titled = None if self._blueprint is None else self._blueprint.find(branch, operation)
        return titled.title if titled is not None and titled.title else operation.replace("_", " ").capitalize()

    def _acts(self, name: str) -> bool | None:
        branch, _, operation = name.partition(".")
        if self._blueprint is None:
            return None
        spec = self._blueprint.find(branch, operation)
        return spec is not None and spec.affects_patient


def _runs(rows: Sequence[StoredRow]) -> list[ReportedRun]:
    """Return the runs of the daemon, by the sessions that the rows name."""
    found = []
    for session, group in itertools.groupby(rows, key=lambda stored: stored.row.session_id):
        rows_of_run = list(group)
        found.append(
            ReportedRun(
                session=session,
                begun=rows_of_run[0].row.wall,
                ended=rows_of_run[-1].row.wall,
                in_order=any(stored.row.source == SHUTDOWN for stored in rows_of_run),
                patient=_patient(rows_of_run),
                first=rows_of_run[0].sequence,
                last=rows_of_run[-1].sequence,
            )
        )
    return found


def _runs_of_session(runs: Sequence[ReportedRun], session: str | None, path: Path) -> tuple[int, int]:
    """Return the indices of a session's first and last run: it continues in the next one after an unexpected end."""
    first = last_run = find_session([run.session for run in runs], session, path)
    while first > 0 and _continues(runs[first - 1], runs[first]):
        first -= 1
    return first, last_run


def _continues(one: ReportedRun, other: ReportedRun) -> bool:
    return not one.in_order and other.patient == one.patient and other.begun - one.ended < LONGEST_PAUSE


def _patient(rows: Iterable[StoredRow]) -> str:
    started = next((stored.row.result or {} for stored in rows if stored.row.kind == "config"), {})
    return str(started.get("settings", {}).get("procedure", {}).get("patient", ""))


def _driver(settings: Mapping[str, Any], device: str) -> str:
    """Return the driver of a device; empty if it has none."""
    driver = str(settings.get(device, {}).get("driver", ""))
    return "" if driver == "none" else driver


def _blueprint(row: JournalRow, settings: Mapping[str, Any]) -> Blueprint | None:
    """Return exactly the workflow under which a row was decided; None if it is not installed here."""
    for name in (str(settings.get("workflow", "")), row.blueprint.id):
        with suppress(ConfigurationError, OSError):
            path = find_workflow(name).blueprint
            found, _ = read_blueprint(path.read_bytes(), str(path), path.parent)
            if found is not None and found.hash == row.blueprint.hash:
                return found
    return None


def _changed(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the settings that differ from the defaults of the workflow, or of PCMRS if it is not installed."""
    if not settings:
        return ()
    try:
        defaults = read_settings(None, (f"workflow={settings.get('workflow', '')}",))
    except (ConfigurationError, BlueprintError):
        defaults = read_settings(None, ())
    default = dict(_flat(as_table(defaults)))
    return tuple(f"{name} = {value!r}" for name, value in _flat(settings) if default.get(name, ()) != value)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", list(value) if isinstance(value, tuple) else value


def _registered(stored: Mapping[str, Any]) -> Registered | None:
    """Return a stored registration; None if another version wrote it in another form."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(stored, Registered)
    return None


def _landmarks(registered: Registered) -> Iterator[ReportedLandmark]:
    """Yield each landmark with its distance after the fit."""
    fit = as_transform(registered.body_ref_from_image)
    for landmark, point in zip(registered.landmarks, registered.digitized, strict=True):
        left = fit @ landmark.position - np.array(point)
        yield ReportedLandmark(name=landmark.name, distance_mm=1e3 * float(np.linalg.norm(left)))


def _message(pose: Transform | None) -> PoseMessage | None:
    return None if pose is None else as_message(pose)


def _event_kind(row: JournalRow) -> EventKind | None:
    """Return the kind of an event; None if the row is not an event, or is routine."""
    if row.kind == "event":
        return "notice"
    if row.kind != "device" or row.operation in ROUTINE:
        return None
    if row.operation == STOPPED:
        return None if row.source == SHUTDOWN else "stop"
    return "fault" if (row.result or {}).get("danger") else "notice"


def _is_same(one: ReportedEvent, other: ReportedEvent) -> bool:
    same = (one.kind, one.source, one.code, one.text) == (other.kind, other.source, other.code, other.text)
    return same and other.wall - one.wall < SAME_EVENT


def _is_committed(row: JournalRow) -> bool:
    """Return whether the row shows the present states of the branches; an intent shows possible later ones."""
    return row.states is not None and row.kind != "intent"


def _merged(entries: Iterable[TimelineEntry]) -> Iterator[TimelineEntry]:
    """Yield the entries, repeats in a row as one."""
    last: TimelineEntry | None = None
    for entry in entries:
        if last is not None and (last.what, last.who, last.outcome, last.state, last.text) == (
            entry.what,
            entry.who,
            entry.outcome,
            entry.state,
            entry.text,
        ):
            last = msgspec.structs.replace(last, times=last.times + 1)
            continue
        if last is not None:
            yield last
        last = entry
    if last is not None:
        yield last


def _entry(stored: StoredRow, *, what: str, outcome: str, text: str, state: str = "") -> TimelineEntry:
    return TimelineEntry(
        sequence=stored.sequence,
        wall=stored.row.wall,
        what=what,
        who=_who(stored.row),
        outcome=outcome,
        state=state,
        text=text,
        times=1,
    )


def _who(row: JournalRow) -> str:
    """Return who asked or reported: the user, if known, and the source."""
    source = source_without_port(row.source)
    return f"{row.user}, {source}" if row.user and row.user not in source else source


def _mm(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
