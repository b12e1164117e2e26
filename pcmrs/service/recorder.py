"""The dispatcher's recorder on the journal of the cell."""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import JournalError
from pcmrs.fsm.blueprint import MigrationSpec
from pcmrs.journal import Journal, JournalRow, Kind
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Reason, Verdict
from pcmrs.workflows.data import PlacementData

TAKEN_BACK = {"registration": ("previous", "noise"), "digitization": ("previous_digitization",)}
"""Branch to its data that outlives a run of the daemon: what only explicit operations use, after their checks, and how
noisy each pointer has been found."""


class JournalRecorder:
    """Writes intents, decisions and events of one daemon run.

    Args:
        journal: The cell's journal.
        clock: The cell's clock.
        session: Id of this run.
        blueprint: The workflow that is decided under.
    """

    def __init__(self, journal: Journal, clock: Clock, session: str, blueprint: BlueprintTag) -> None:
        self._journal = journal
        self._clock = clock
        self._common: dict[str, Any] = {"session_id": session, "boot_id": _boot_id(), "blueprint": blueprint}

    def intent(self, command: Command, states: Mapping[str, str]) -> Awaitable[Any]:
        """See `Recorder.intent`."""
        return self._journal.append([self._of_command("intent", command, states)])

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
        outcome = self._of_command("outcome", command, states, verdict=verdict, result=result)
        intent = [self._of_command("intent", command, states)] if with_intent else []
        return self._journal.append([*intent, outcome])

    def event(self, event: DeviceEvent, states: Mapping[str, str]) -> Awaitable[Any]:
        """See `Recorder.event`."""
        row = self._row(
            "device",
            source=event.device,
            operation=event.code,
            states=dict(states),
            result={"text": event.text, "danger": event.danger, "fields": msgspec.to_builtins(event.fields)},
        )
        return self._journal.append([row])

    def recall(self, source: str, command_id: str) -> Verdict | None:
        """See `Recorder.recall`."""
        return self._journal.reader.verdict_of(source, command_id)

    async def taken_up(self, migration: MigrationSpec) -> None:
        """Journals that what an older blueprint has written is taken up under the present one, and why."""
        text = f"Taken up from {migration.version} {migration.hash} because {migration.why}"
        result = {"text": text, **msgspec.to_builtins(migration)}
        await self._journal.append([self._row("event", source="daemon", operation="taken_up", result=result)])

    async def close_unfinished(self) -> list[Verdict]:
        """Journals ``unknown`` for what an earlier run had begun when it ended; returns those verdicts."""
        verdicts = []
        for intent in self._journal.reader.unfinished():
            verdict = Verdict(
                id=intent.command_id or "",
                branch=intent.branch or "",
                operation=intent.operation or "",
                decision="unknown",
                state=(intent.states or {}).get(intent.branch or "", ""),
                sequence=0,
                reason=Reason(code="daemon_ended", text="The daemon ended while it ran; nobody knows how it ended."),
            )
            row = self._row(
                "outcome",
                command_id=intent.command_id,
                source=intent.source,
                branch=intent.branch,
                operation=intent.operation,
                verdict=verdict,
            )
            await self._journal.append([row])
            verdicts.append(verdict)
        return verdicts

    def previous(self, initial: PlacementData) -> PlacementData:
        """The initial data, with what earlier runs registered and digitized last for explicit operations to take back.

        Raises:
            JournalError: What an earlier run has left is not of the types that this program knows.
        """
        changes: dict[str, Any] = {}
        for branch, fields in TAKEN_BACK.items():
            for stored in self._journal.reader.read(kind="outcome", branch=branch):
                kept = stored.row.result or {}
                changes |= {field: kept[field] for field in fields if kept.get(field)}
        try:
            previous = msgspec.convert(changes, PlacementData)
        except msgspec.ValidationError as error:
            path = self._journal.reader.path
            text = f"{path} holds registrations that this version cannot read ({error}): give another cell.folder."
            raise JournalError(text, path=str(path)) from None
        kept = {field: getattr(previous, field) for fields in TAKEN_BACK.values() for field in fields}
        return msgspec.structs.replace(initial, **kept)

    def _of_command(self, kind: Kind, command: Command, states: Mapping[str, str], **more: Any) -> JournalRow:
        return self._row(
            kind,
            command_id=command.id,
            source=command.source,
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
