"""Keys that match a journalled row with its replayed counterpart."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal, NamedTuple

from pcmrs.journal import JournalRow
from pcmrs.messages import Command
from pcmrs.messages.identity import ON_SITE

RowKind = Literal["intent", "outcome", "device"]
COMPARED: tuple[RowKind, ...] = ("intent", "outcome", "device")
"""Kinds of rows that the dispatcher writes; the daemon itself writes the others."""

_DRAWN = re.compile(r"-[0-9a-f]{32}$")
_DRAWS_IDS = ("device:", "activity:", "timer:")


class RowKey(NamedTuple):
    """Key of a row within one run of the daemon; rows with the same key are matched in their order.

    Attributes:
        source: Source of the command or event.
        what: Branch and operation, or the event's code and ``danger``.
        id: Id of the command without its random part; empty for events.
    """

    kind: RowKind
    source: str
    what: str
    id: str = ""


def command_key(kind: RowKind, command: Command) -> RowKey:
    """Return the key of a command's intent or outcome.

    Args:
        kind: ``intent`` or ``outcome``.
        command: The command.
    """
    return RowKey(kind, command.source, f"{command.branch}.{command.operation}", _lasting(command.source, command.id))


def event_key(source: str, code: str, *, danger: bool) -> RowKey:
    """Return the key of an event.

    Args:
        source: Source of the event.
        code: Code of the event.
        danger: True if it stops the cell.
    """
    return RowKey("device", source, f"{code}, danger" if danger else code)


def key_of(row: JournalRow) -> RowKey | None:
    """Return the key of a row; None for a row that no dispatcher writes."""
    if row.kind == "device":
        return event_key(row.source or "", row.operation or "", danger=is_danger(row))
    if row.kind not in COMPARED:
        return None
    return command_key(row.kind, command_of(row))


def command_of(row: JournalRow) -> Command:
    """Return the command of an intent or outcome, without the time at which it was sent, which is not journalled."""
    return Command(
        id=row.command_id or "",
        branch=row.branch or "",
        operation=row.operation or "",
        source=row.source or "",
        user=row.user or ON_SITE.user,
        role=row.role or ON_SITE.role,
        arguments=row.arguments or {},
        parent=row.parent,
    )


def is_followed_by_report(row: JournalRow) -> bool:
    """Return whether the dispatcher itself submitted the command after a device reported an event of that name."""
    drawn = _DRAWN.search(row.command_id or "") is not None
    return drawn and (row.source or "").startswith("device:")


def same_reason(row: JournalRow, code: str | None, text: str) -> bool:
    """Return whether the row has this reason.

    Args:
        row: Outcome.
        code: Code of the reason.
        text: Text of the reason.
    """
    reason = row.verdict.reason if row.verdict is not None else None
    return reason is not None and (reason.code, reason.text) == (code, text)


def is_rejection(row: JournalRow) -> bool:
    """Return whether the row is the outcome of a rejected command."""
    return row.kind == "outcome" and row.verdict is not None and row.verdict.decision == "rejected"


def is_rejected_report(row: JournalRow) -> bool:
    """Return whether the row rejects a report of a device, activity or timer; only older journals have such rows."""
    return is_rejection(row) and (row.source or "").startswith(_DRAWS_IDS)


def is_danger(row: JournalRow) -> bool:
    """Return whether the row is an event that stopped the cell, or reports that Stop is not confirmed."""
    result: Mapping[str, object] = row.result or {}
    return row.kind == "device" and bool(result.get("danger"))


def _lasting(source: str, command_id: str) -> str:
    return _DRAWN.sub("-", command_id) if source.startswith(_DRAWS_IDS) else command_id
