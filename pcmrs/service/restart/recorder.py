"""Recorder of the dispatcher on the journal of the cell."""

from __future__ import annotations

import asyncio
import platform
from array import array
from bisect import bisect_left
from collections.abc import Awaitable, Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.clock import Clock
from pcmrs.dispatcher.events import DAEMON, EarlierDecision
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.errors import JournalError
from pcmrs.fsm import Blueprint
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import Journal, JournalRow, Kind
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Verdict
from pcmrs.messages.clipping import clipped
from pcmrs.pki import Approval
from pcmrs.service.restart.state import ENDED, TAKEN_BACK, InFlightCommand, PersistedState, RestartState
from pcmrs.workflows.data import PlacementData


class DecidedKeys:
    """Hashes of source and id of the commands that have been decided, 8 bytes for each: journals hold many.

    A command that is not in it was never decided. One that is in it most probably was: only the journal can say. It is
    no cache of verdicts, as `CommandCache` is: it forgets nothing, and only saves looking in the journal.

    Args:
        earlier: Source and id of the commands that earlier runs have decided.
    """

    def __init__(self, earlier: Iterable[tuple[str, str]]) -> None:
        self._earlier = array("q", sorted(map(hash, earlier)))
        self._since: set[int] = set()

    def add(self, source: str, command_id: str) -> None:
        """Add a command that is about to be journalled.

        Args:
            source: Source of the command.
            command_id: Id that the source has given it.
        """
        self._since.add(hash((source, command_id)))

    def __contains__(self, key: tuple[str, str]) -> bool:
        wanted = hash(key)
        place = bisect_left(self._earlier, wanted)
        return wanted in self._since or (place < len(self._earlier) and self._earlier[place] == wanted)


AT_ONCE = 100
"""Limit of rows of unfinished commands that are written in one commit."""
SNAPSHOT_EVERY = 1000
"""Number of rows after which the journal gets a snapshot, from which the next start reads on."""


class JournalRecorder:
    """Writer of intents, decisions and events of one daemon run.

    Args:
        journal: The cell's journal.
        clock: The cell's clock.
        session: Id of this run.
        blueprint: The workflow of the decisions.

    Raises:
        JournalError: The journal cannot be read.
    """

    def __init__(self, journal: Journal, clock: Clock, session: str, blueprint: BlueprintTag) -> None:
        self._journal = journal
        self._clock = clock
        self._common: dict[str, Any] = {"session_id": session, "boot_id": _boot_id(), "blueprint": blueprint}
        self._decided = DecidedKeys(journal.reader.decided())
        self._restart_state: RestartState | None = None
        self._procedure: Procedure[Any, Any] | None = None
        self._since_snapshot = 0

    def intent(self, command: Command, states: Mapping[str, str]) -> Awaitable[Any]:
        """See `Recorder.intent`."""
        return self._append([self._of_command("intent", command, states)])

    def decision(
        self,
        command: Command,
        verdict: Verdict,
        states: Mapping[str, str],
        changes: Mapping[str, Any],
        *,
        with_intent: bool,
    ) -> Awaitable[Any]:
        """See `Recorder.decision`."""
        result = msgspec.to_builtins(dict(changes)) if changes else None
        intent = [self._of_command("intent", command, states)] if with_intent else []
        if verdict.decision == "rejected":
            command = msgspec.structs.replace(command, arguments=dict(clipped(command.arguments)))
        outcome = self._of_command("outcome", command, states, verdict=verdict, result=result)
        return self._append([*intent, outcome])

    def event(self, event: DeviceEvent, states: Mapping[str, str]) -> Awaitable[Any]:
        """See `Recorder.event`."""
        row = self._row(
            "device",
            source=event.device,
            operation=event.code,
            states=dict(states),
            result={"text": event.text, "danger": event.danger, "fields": msgspec.to_builtins(event.fields)},
        )
        return self._append([row])

    def recall(self, source: str, command_id: str) -> EarlierDecision | None:
        """See `Recorder.recall`."""
        if (source, command_id) not in self._decided:
            return None
        reader = self._journal.reader
        outcome = reader.outcome_of(source, command_id)
        if outcome is None or outcome.verdict is None:
            return None
        # The row that has closed a command of an earlier run repeats no arguments.
        intent = outcome if outcome.arguments is not None else reader.intent_of(source, command_id)
        return EarlierDecision(outcome.verdict, {} if intent is None else intent.arguments or {})

    def read_back(self, blueprint: Blueprint) -> PersistedState:
        """Return the state that the journal leaves, from its last snapshot on; later snapshots continue from it.

        Args:
            blueprint: The workflow.

        Raises:
            JournalError: The journal cannot be read, or this program does not know the types of its snapshot.
        """
        reader = self._journal.reader
        snapshot = next(reader.read(kind="snapshot", last=1), None)
        kept = PersistedState() if snapshot is None else self._kept_in(snapshot.row)
        restart_state, rows = RestartState(blueprint, kept), 0
        for stored in reader.read(after=0 if snapshot is None else snapshot.sequence):
            restart_state.take(stored.row)
            rows += 1
        self._restart_state, self._since_snapshot = restart_state, rows
        return restart_state.kept

    @property
    def kept(self) -> PersistedState:
        """State that a run that begins now would take over."""
        return PersistedState() if self._restart_state is None else self._restart_state.kept

    def attach(self, procedure: Procedure[Any, Any]) -> None:
        """Take states, data and sequence of later snapshots from this procedure."""
        self._procedure = procedure

    async def started(self, settings: Mapping[str, Any], calibration: str) -> int:
        """Journal configuration, versions and calibration of this run; return the sequence of the row.

        Args:
            settings: The whole configuration.
            calibration: Id of the calibration.
        """
        versions = {"pcmrs": version("pcmrs"), "python": platform.python_version()}
        result = {"settings": dict(settings), "versions": versions, "calibration": calibration}
        return await self._append([self._row("config", source=DAEMON, operation="started", result=result)])

    async def record_migration(self, migration: MigrationSpec) -> None:
        """Journal that the present blueprint continues the journal of an older one, and why."""
        text = f"Taken up from {migration.version} {migration.hash} because {migration.why}"
        result = {"text": text, **msgspec.to_builtins(migration)}
        await self._append([self._row("event", source=DAEMON, operation="taken_up", result=result)])

    async def record_approval(self, approval: Approval) -> None:
        """Journal who has approved the drafted workflow, and when."""
        text = f"Drafted by a language model, and approved by {approval.by}"
        result = {"text": text, **msgspec.to_builtins(approval)}
        await self._append([self._row("event", source=DAEMON, operation="draft_approved", result=result)])

    async def close_unfinished(self, begun: Iterable[InFlightCommand]) -> list[Verdict]:
        """Journal ``unknown`` for commands that were unfinished when an earlier run ended; return those verdicts."""
        rows = [self._unknown(each) for each in begun]
        for start in range(0, len(rows), AT_ONCE):
            await self._append(rows[start : start + AT_ONCE])
        return [row.verdict for row in rows if row.verdict is not None]

    async def conclude(self) -> None:
        """Journal a snapshot at the end of the daemon: the next start need only read this.

        Raises:
            JournalError: The snapshot cannot be written.
        """
        if self._restart_state is not None:
            await self._journal.append([self._snapshot()])

    def previous(self, kept: PersistedState, initial: PlacementData) -> PlacementData:
        """Return the initial data, with the data of earlier runs that explicit operations may take back.

        Args:
            kept: State of earlier runs.
            initial: Initial data of the workflow.

        Raises:
            JournalError: This program does not know the types of the data of an earlier run.
        """
        try:
            previous = msgspec.convert(kept.taken_back, PlacementData)
        except msgspec.ValidationError as error:
            path = self._journal.reader.path
            text = f"{path} holds registrations that this version cannot read ({error}): give another cell.folder."
            raise JournalError(text, path=str(path)) from None
        return msgspec.structs.replace(initial, **{field: getattr(previous, field) for field in TAKEN_BACK})

    def _append(self, rows: list[JournalRow]) -> Awaitable[int]:
        """Append rows, and in the same commit a snapshot if one is due.

        After a failure the state in memory may differ from the disk: there is no snapshot before it is read back.
        """
        for row in rows:
            if row.kind == "outcome":
                self._decided.add(row.source or "", row.command_id or "")
        if self._restart_state is not None:
            rows = self._followed(rows, self._restart_state)
        try:
            written = self._journal.append(rows)
        except JournalError:
            self._restart_state = None
            raise
        if written.done():
            self._check(written)
        else:
            written.add_done_callback(self._check)
        return written

    def _followed(self, rows: list[JournalRow], restart_state: RestartState) -> list[JournalRow]:
        for row in rows:
            restart_state.take(row)
        self._since_snapshot += len(rows)
        if self._since_snapshot < SNAPSHOT_EVERY:
            return rows
        self._since_snapshot = 0
        return [*rows, self._snapshot()]

    def _check(self, written: asyncio.Future[int]) -> None:
        if written.cancelled() or written.exception() is not None:
            self._restart_state = None

    def _snapshot(self) -> JournalRow:
        procedure = self._procedure
        shown: dict[str, Any] = {"data": {}, "sequence": 0}
        if procedure is not None:
            shown = {"data": msgspec.to_builtins(procedure.data), "sequence": procedure.sequence}
        return self._row(
            "snapshot",
            source=DAEMON,
            operation="snapshot",
            states=None if procedure is None else procedure.promised(),
            result={**shown, **msgspec.to_builtins(self.kept)},
        )

    def _kept_in(self, row: JournalRow) -> PersistedState:
        try:
            return msgspec.convert(row.result or {}, PersistedState)
        except msgspec.ValidationError as error:
            path = self._journal.reader.path
            text = f"{path} holds a snapshot that this version cannot read ({error}): give another cell.folder."
            raise JournalError(text, path=str(path)) from None

    def _unknown(self, begun: InFlightCommand) -> JournalRow:
        verdict = Verdict(
            id=begun.command,
            branch=begun.branch,
            operation=begun.operation,
            decision="unknown",
            state=begun.state,
            sequence=0,
            reason=ENDED,
        )
        return self._row(
            "outcome",
            command_id=begun.command,
            source=begun.source,
            branch=begun.branch,
            operation=begun.operation,
            verdict=verdict,
        )

    def _of_command(self, kind: Kind, command: Command, states: Mapping[str, str], **more: Any) -> JournalRow:
        return self._row(
            kind,
            command_id=command.id,
            source=command.source,
            user=command.user,
            role=command.role,
            branch=command.branch,
            operation=command.operation,
            arguments=command.arguments,
            parent=command.parent,
            states=dict(states),
            **more,
        )

    def _row(self, kind: Kind, **fields: Any) -> JournalRow:
        wall, monotonic = self._clock.wall(), self._clock.monotonic()
        return JournalRow(kind=kind, wall=wall, monotonic=monotonic, **self._common, **fields)


def _boot_id() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
