"""A journal of twelve rows, and `pcmrs journal` on it."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag, Reason, Verdict

EVERY_ROW: dict[str, Any] = {
    "wall": 1.7e9,
    "monotonic": 1.0,
    "boot_id": "boot",
    "session_id": "s",
    "blueprint": BlueprintTag(id="ratms", version="1", hash="0"),
}


def rows_of(number: int) -> list[JournalRow]:
    command: dict[str, Any] = {
        "command_id": f"c{number}",
        "source": "bus:local",
        "branch": "robot",
        "operation": "connect",
    }
    reason = Reason(code="silent", text="The robot, alas, is silent.")
    told: dict[str, Any] = {"id": f"c{number}", "branch": "robot", "operation": "connect", "state": "0", "sequence": 1}
    verdict = Verdict(decision="failed", reason=reason, **told)
    arguments = {"speed": 0.1, "text": 'with "quotes", commas\nand lines'}
    return [
        JournalRow(kind="intent", arguments=arguments, **command, **EVERY_ROW),
        JournalRow(kind="outcome", verdict=verdict, states={"robot": "0"}, **command, **EVERY_ROW),
        JournalRow(kind="device", source="robot", operation="link_lost", result={"text": "Gone."}, **EVERY_ROW),
    ]


def journal_command(*words: object) -> Result:
    return CliRunner().invoke(main, ["journal", *(str(word) for word in words)])


def damage(journal_path: Path, sequence: int) -> None:
    with sqlite3.connect(journal_path) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_update'").fetchone()
        connection.execute("DROP TRIGGER no_update")
        connection.execute("UPDATE journal SET body = x'00' WHERE sequence = ?", (sequence,))
        connection.execute(guard)
    connection.close()


def cut(path: Path, last: int) -> None:
    """Removes the rows after `last`, past the journal's guard."""
    with sqlite3.connect(path) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'no_delete'").fetchone()
        connection.execute("DROP TRIGGER no_delete")
        connection.execute("DELETE FROM journal WHERE sequence > ?", (last,))
        connection.execute(guard)
    connection.close()
