"""A session's report from the rows of its journal."""

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
from pcmrs.errors import BlueprintError, ConfigurationError, GeometryError, JournalError, PcmrsError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import PoseMessage
from pcmrs.report.advice import WRONG_TIME, advise
from pcmrs.report.record import (
    Branch,
    Done,
    Entry,
    Event,
    EventKind,
    Gate,
    Landmark,
    Placement,
    Plan,
    Refusal,
    Registration,
    Run,
    SessionReport,
    Span,
    Unknown,
)
from pcmrs.report.source import Source, files_of, open_source
from pcmrs.service.restart.state import PersistedState, RestartState
from pcmrs.settings import DEVICES, read_settings
from pcmrs.spatial import Transform
from pcmrs.workflows import find_workflow
from pcmrs.workflows.data import Registered, as_message, as_transform

CONTINUES: Final = 3600.0
"""A run that begins within this after one of the same patient that did not end in order goes on with its session, s."""
ROUTINE: Final = frozenset({"activity_started", "activity_ended"})
"""Codes of what is reported although nothing is the matter."""
STOPPED: Final = "stopped"
"""Code of a Stop that somebody asked for."""
AT_ONCE: Final = 1.0
"""What is reported again within this is reported once, s: a client asks for Stop on more than one way."""
NAMED: Final = ("surgeon", "operator")
"""Arguments in which a command names a person."""


def read_report(path: Path, session: str | None = None) -> SessionReport:
    """Everything that a report says.

    Args:
        path: Of an exported session, of a cell's folder, or of a journal.
        session: How the id of the session begins; None for the one that was exported, otherwise for the last one.

    Raises:
        JournalError: Nothing can be read, there is no such session, or a row holds what this program does not write.
    """
    source = open_source(path)
    try:
        # Values of the configuration are taken as they are: what draws the page relies on their types.
        return msgspec.convert(msgspec.to_builtins(_report(source, session)), SessionReport)
    except PcmrsError:
        raise
    except Exception as error:  # rows of another program stumble wherever a value is not of the kind that ours writes
        what = f"{type(error).__name__}: {error}"
        text = f"{source.path} cannot be reported: a row holds what this program does not write ({what})."
        raise JournalError(text, path=str(source.path)) from error


def _report(source: Source, session: str | None) -> SessionReport:
    runs = _runs(source.rows)
    first, last = _chosen(runs, session if session is not None else source.exported, source.path)
    chosen = runs[first : last + 1]
    rows = [stored for stored in source.rows if chosen[0].first <= stored.sequence <= chosen[-1].last]
    final = rows[-1].row
    started = [stored.row.result or {} for stored in rows if stored.row.kind == "config"]
    config = started[-1] if started else {}
    settings = config.get("settings", {})
    procedure = settings.get("procedure", {})
    blueprint = _blueprint(final, settings)
    known = None if blueprint is None else _Known(source.rows, chosen[-1].last, blueprint)
    reading = _Reading(rows, procedure, blueprint)
    calibrations = {
        kind: given for kind in ("tool", "pointer") if (given := procedure.get("calibration", {}).get(f"{kind}_file"))
    }
    return SessionReport(
        patient=str(procedure.get("patient", "")),
        operator=str(procedure.get("operator", "")),
        named=reading.named(),
        asked=reading.asked(),
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
        asked_for=sum(1 for _ in reading.verdicts()),
        counts=reading.counts(),
        registrations=tuple(reading.registrations()),
        plans=tuple(reading.plans()),
        placements=tuple(reading.placements()),
        done=reading.done(),
        refusals=reading.refusals(),
        unknown=tuple(reading.unknown(known)),
        events=tuple(reading.events()),
        latched=None if known is None else known.latched,
        branches=tuple(reading.branches()),
        timeline=tuple(_merged(reading.timeline(chosen))),
        calibration=str(config.get("calibration", "")),
        versions={str(name): str(value) for name, value in config.get("versions", {}).items()},
        reported_by=version("pcmrs"),
        changed=_changed(settings),
        files=files_of(source, [run.session for run in chosen], calibrations),
    )


class _Known:
    """What was unsettled and latched at the end of a session, as the daemon itself would take it over."""

    def __init__(self, rows: Iterable[StoredRow], last: int, blueprint: Blueprint) -> None:
        ledger = RestartState(blueprint, PersistedState())
        for stored in rows:
            if stored.sequence <= last:
                ledger.take(stored.row)
        kept = ledger.kept
        self.latched = kept.latched
        # Of one operation a ledger keeps the newest only: none of its outcomes counts as settled while that one is not.
        self.unsettled = {f"{each.branch}.{each.operation}" for each in (*kept.unknown, *kept.begun, *kept.moving)}


class _Reading:
    """The rows of one session, asked for one thing after the other.

    Args:
        rows: In order.
        procedure: Its settings, as plain data.
        blueprint: The workflow; None where it is not known here.
    """

    def __init__(self, rows: Sequence[StoredRow], procedure: Mapping[str, Any], blueprint: Blueprint | None) -> None:
        self._rows = rows
        self._procedure = procedure
        self._blueprint = blueprint

    def verdicts(self) -> Iterator[StoredRow]:
        """The rows that say how something ended."""
        return (stored for stored in self._rows if stored.row.kind == "outcome" and stored.row.verdict is not None)

    def counts(self) -> dict[str, int]:
        """How many operations ended in which way."""
        return dict(Counter(_decision(stored.row) for stored in self.verdicts()))

    def asked(self) -> tuple[str, ...]:
        """Who has asked for operations, in the order in which they did first."""
        rows = [stored.row for stored in self.verdicts() if stored.row.user and stored.row.role != "daemon"]
        return tuple(dict.fromkeys(f"{row.user} ({row.role or 'role unknown'})" for row in rows))

    def named(self) -> tuple[str, ...]:
        """Who is named in accepted commands."""
        given = [stored.row.arguments or {} for stored in self._accepted()]
        names = [f"{arguments[role]} ({role})" for arguments in given for role in NAMED if arguments.get(role)]
        return tuple(dict.fromkeys(names))

    def registrations(self) -> Iterator[Registration]:
        """All that were put in force."""
        limits = self._procedure.get("registration", {})
        for stored in self._accepted():
            kept = (stored.row.result or {}).get("registered")
            if not kept:
                continue
            told = _told(stored.row)
            judged = told.get("landmarks") if isinstance(told.get("landmarks"), dict) else told
            gates = tuple(msgspec.convert(gate, Gate) for gate in (judged or {}).get("gates", ()))
            by_name = {gate.name: gate.limit for gate in gates}
            registered = _registered(kept)
            yield Registration(
                sequence=stored.sequence,
                wall=stored.row.wall,
                operation=_name(stored.row),
                residual_mm=_mm(kept.get("residual")),
                rms_mm=_mm(kept.get("rms")),
                residual_limit_mm=_mm(by_name.get("residual_too_large")) or limits.get("residual_limit_mm"),
                tre_mm=_mm(told.get("tre")),
                tre_limit_mm=_mm(by_name.get("tre_too_large")) or limits.get("tre_limit_mm"),
                target=str((told.get("target") or {}).get("at", "")),
                landmarks=() if registered is None else tuple(_landmarks(registered)),
                gates=gates,
                id=str(kept.get("id", "")),
            )

    def plans(self) -> Iterator[Plan]:
        """All that were put in force."""
        for stored in self._accepted():
            if (stored.row.result or {}).get("plan"):
                tre = _mm(_told(stored.row).get("tre"))
                yield Plan(sequence=stored.sequence, wall=stored.row.wall, operation=_name(stored.row), tre_mm=tre)

    def placements(self) -> Iterator[Placement]:
        """Every time that the tool was measured against its planned pose."""
        for stored in self._accepted():
            told = _told(stored.row)
            if "planned" not in told or "translation_error" not in told or "rotation_error" not in told:
                continue
            standoff = float(told.get("confirm_offset", 0.0))
            planned, measured = _pose(told, "planned"), _pose(told, "measured")
            axes = None
            if planned is not None and measured is not None:
                error = placement_error(as_transform(planned), as_transform(measured), standoff)
                x, y, z = (1e3 * error.vector).tolist()
                axes = (x, y, z)
            yield Placement(
                sequence=stored.sequence,
                wall=stored.row.wall,
                operation=_name(stored.row),
                error_mm=1e3 * told["translation_error"],
                error_deg=math.degrees(told["rotation_error"]),
                axes_mm=axes,
                planned=planned,
                measured=measured,
                standoff=standoff,
            )

    def done(self) -> tuple[Done, ...]:
        """What was accepted, in the order of the first time."""
        times = Counter(_name(stored.row) for stored in self._accepted())
        return tuple(
            Done(operation=name, title=self._title(name), times=count, acts=self._acts(name))
            for name, count in times.items()
        )

    def refusals(self) -> tuple[Refusal, ...]:
        """What was not accepted, the same for the same reason in one line."""
        found: dict[tuple[str, ...], Refusal] = {}
        for stored in self.verdicts():
            row = stored.row
            verdict = row.verdict
            if verdict is None or verdict.decision == "accepted":
                continue
            code, text = ("", "") if verdict.reason is None else (verdict.reason.code, verdict.reason.text)
            key = (_name(row), verdict.decision, code, text)
            if key in found:
                found[key] = msgspec.structs.replace(found[key], times=found[key].times + 1)
                continue
            found[key] = Refusal(
                sequence=stored.sequence,
                wall=row.wall,
                operation=_name(row),
                who=_who(row),
                decision=verdict.decision,
                code=code,
                text=text,
                advice=advise(verdict, self._blueprint),
                checked=code not in WRONG_TIME and code != "bad_arguments",
                times=1,
            )
        return tuple(found.values())

    def unknown(self, known: _Known | None) -> Iterator[Unknown]:
        """What ended in a way that nobody knows, and what had begun when the session broke off."""
        ended = {(stored.row.source, stored.row.command_id) for stored in self.verdicts()}
        for stored in self._rows:
            row = stored.row
            begun = row.kind == "intent" and (row.source, row.command_id) not in ended
            if begun:
                text = "It had begun when the session broke off."
            elif row.kind == "outcome" and _decision(row) == "unknown":
                text = row.verdict.reason.text if row.verdict is not None and row.verdict.reason is not None else ""
            else:
                continue
            name = _name(row)
            settled = None if known is None else name not in known.unsettled
            yield Unknown(sequence=stored.sequence, wall=row.wall, operation=name, text=text, settled=settled)

    def events(self) -> Iterator[Event]:
        """What devices and the daemon reported, but for what is routine; the same in a row is one."""
        found: list[Event] = []
        for stored in self._rows:
            kind = _event_kind(stored.row)
            if kind is None:
                continue
            event = Event(
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

    def branches(self) -> Iterator[Branch]:
        """Every branch with its states over time."""
        moments = [(stored.row.wall, stored.row.states) for stored in self._rows if _is_committed(stored.row)]
        end = self._rows[-1].row.wall
        names = dict.fromkeys(name for _, states in moments for name in states or {})
        for name in names:
            walls = [(wall, states[name]) for wall, states in moments if states and name in states]
            changes = [next(group) for _, group in itertools.groupby(walls, key=lambda each: each[1])]
            ends = [*(wall for wall, _ in changes[1:]), end]
            spec = None if self._blueprint is None else self._blueprint.branches.get(name)
            yield Branch(
                name=name,
                title=name if spec is None else spec.title or name,
                states={} if spec is None else dict(spec.states),
                spans=tuple(
                    Span(state=state, begun=wall, ended=until)
                    for (wall, state), until in zip(changes, ends, strict=True)
                ),
                final=changes[-1][1],
            )

    def timeline(self, runs: Sequence[Run]) -> Iterator[Entry]:
        """What was done, what went wrong and what was reported, in order; what was only rejected is not in it."""
        starts = {run.first: run for run in runs}
        for stored in self._rows:
            row = stored.row
            if stored.sequence in starts:
                run = f"session {starts[stored.sequence].session}"
                yield _entry(stored, what="The daemon begins", outcome="run", text=run)
            kind = _event_kind(row)
            if kind is not None:
                text = str((row.result or {}).get("text", ""))
                yield _entry(stored, what=row.operation or "", outcome=kind, text=text)
            elif row.kind == "outcome" and row.verdict is not None and row.verdict.decision != "rejected":
                reason = row.verdict.reason
                text = "" if reason is None else reason.text
                yield _entry(stored, what=_name(row), outcome=row.verdict.decision, text=text, state=row.verdict.state)
            elif row.source == SHUTDOWN:
                yield _entry(stored, what="The daemon ends in order", outcome="run", text="")

    def _accepted(self) -> Iterator[StoredRow]:
        return (stored for stored in self.verdicts() if _decision(stored.row) == "accepted")

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


def _runs(rows: Sequence[StoredRow]) -> list[Run]:
    """The runs of the daemon, by the sessions that the rows name."""
    found = []
    for session, group in itertools.groupby(rows, key=lambda stored: stored.row.session_id):
        own = list(group)
        found.append(
            Run(
                session=session,
                begun=own[0].row.wall,
                ended=own[-1].row.wall,
                in_order=any(stored.row.source == SHUTDOWN for stored in own),
                patient=_patient(own),
                first=own[0].sequence,
                last=own[-1].sequence,
            )
        )
    return found


def _chosen(runs: Sequence[Run], session: str | None, path: Path) -> tuple[int, int]:
    """First and last run of a session: it goes on in the next run where a daemon did not end in order."""
    wanted = [index for index, run in enumerate(runs) if session is None or run.session.startswith(session)]
    if not wanted or (session is not None and len(wanted) > 1):
        last = ", ".join(run.session for run in runs[-5:])
        text = f"{path} has {len(wanted) or 'no'} sessions that begin with {session or 'anything'}; the last: {last}."
        raise JournalError(text, path=str(path), session=session)
    first = last_run = wanted[-1]
    while first > 0 and _goes_on(runs[first - 1], runs[first]):
        first -= 1
    return first, last_run


def _goes_on(one: Run, other: Run) -> bool:
    return not one.in_order and other.patient == one.patient and other.begun - one.ended < CONTINUES


def _patient(rows: Iterable[StoredRow]) -> str:
    started = next((stored.row.result or {} for stored in rows if stored.row.kind == "config"), {})
    return str(started.get("settings", {}).get("procedure", {}).get("patient", ""))


def _driver(settings: Mapping[str, Any], device: str) -> str:
    """Empty where there is none."""
    driver = str(settings.get(device, {}).get("driver", ""))
    return "" if driver == "none" else driver


def _blueprint(row: JournalRow, settings: Mapping[str, Any]) -> Blueprint | None:
    """The very workflow under which a row was decided, where it is installed here."""
    for name in (str(settings.get("workflow", "")), row.blueprint.id):
        with suppress(ConfigurationError, OSError):
            path = find_workflow(name).blueprint
            found, _ = read_blueprint(path.read_bytes(), str(path), path.parent)
            if found is not None and found.hash == row.blueprint.hash:
                return found
    return None


def _changed(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """What is not the default of the workflow, or where that is not installed, of PCMRS."""
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


def _registered(kept: Mapping[str, Any]) -> Registered | None:
    """None of a registration that another version has written in another form."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(kept, Registered)
    return None


def _landmarks(registered: Registered) -> Iterator[Landmark]:
    """Each with its distance after the fit."""
    fit = as_transform(registered.body_ref_from_image)
    for landmark, point in zip(registered.landmarks, registered.digitized, strict=True):
        left = fit @ landmark.position - np.array(point)
        yield Landmark(name=landmark.name, distance_mm=1e3 * float(np.linalg.norm(left)))


def _pose(told: Mapping[str, Any], key: str) -> PoseMessage | None:
    """None where the result has no such pose."""
    try:
        return as_message(Transform.from_quat_xyzw(told[key]["position"], told[key]["quat_xyzw"]))
    except (KeyError, TypeError, GeometryError):
        return None


def _event_kind(row: JournalRow) -> EventKind | None:
    """None for what is no event, and for routine."""
    if row.kind == "event":
        return "notice"
    if row.kind != "device" or row.operation in ROUTINE:
        return None
    if row.operation == STOPPED:
        return None if row.source == SHUTDOWN else "stop"
    return "fault" if (row.result or {}).get("danger") else "notice"


def _is_same(one: Event, other: Event) -> bool:
    told = (one.kind, one.source, one.code, one.text) == (other.kind, other.source, other.code, other.text)
    return told and other.wall - one.wall < AT_ONCE


def _is_committed(row: JournalRow) -> bool:
    """Whether the row says in which states the branches are; an intent says in which they may end."""
    return row.states is not None and row.kind != "intent"


def _merged(entries: Iterable[Entry]) -> Iterator[Entry]:
    """The same in a row as one."""
    last: Entry | None = None
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


def _entry(stored: StoredRow, *, what: str, outcome: str, text: str, state: str = "") -> Entry:
    return Entry(
        sequence=stored.sequence,
        wall=stored.row.wall,
        what=what,
        who=_who(stored.row),
        outcome=outcome,
        state=state,
        text=text,
        times=1,
    )


def _told(row: JournalRow) -> dict[str, Any]:
    return (row.verdict.result if row.verdict is not None else None) or {}


def _decision(row: JournalRow) -> str:
    return "" if row.verdict is None else row.verdict.decision


def _name(row: JournalRow) -> str:
    return f"{row.branch}.{row.operation}"


def _who(row: JournalRow) -> str:
    """Who asked or reported, without the port, which says nothing."""
    way = ":".join((row.source or "").split(":")[:2])
    return f"{row.user}, {way}" if row.user and row.user not in way else way


def _mm(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
