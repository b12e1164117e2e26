"""Check that a journal that may be damaged is recovered with all its rows, or refused."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow, verify
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import KEY, PUBLIC_KEY, contents, row

__all__ = ["check_sound", "is_recovered", "missing_rows"]


def is_recovered(path: Path, rows: Sequence[StoredRow]) -> bool:
    """Return True if a journal that may be damaged is recovered with every row, False if it is refused.

    Args:
        path: Database file of the journal.
        rows: Rows that it must have.

    Raises:
        Unmet: Damage is not reported: rows are missing or changed, `verify` finds nothing in a refused journal, or a
            refused journal was changed.
    """
    before = contents(path.parent)
    try:
        sound = verify(path).sound
    except JournalError:
        sound = False
    refusal = asyncio.run(_refusal(path))
    if refusal is None:
        missing = asyncio.run(missing_rows(path, rows))
        if missing:
            raise Unmet(f"{missing} rows are missing or changed")
        return True
    if sound and KEY not in refusal.text:  # verifying needs no private key
        raise Unmet(f"verify found nothing, but opening was refused: {refusal.text}")
    after = contents(path.parent)
    changed = [name for name in before if name != PUBLIC_KEY and after.get(name) != before[name]]
    if changed:
        raise Unmet(f"refused, but changed: {', '.join(changed)}")
    return False


async def _refusal(path: Path) -> JournalError | None:
    """Open and close a journal as a daemon does; return the error if that is refused."""
    try:
        journal = Journal.open(path)
    except JournalError as error:
        return error
    await journal.close()
    return None


async def missing_rows(path: Path, rows: Iterable[StoredRow]) -> int:
    """Open a journal as a daemon does, append a row, and return how many rows are missing or changed.

    Args:
        path: Database file of the journal.
        rows: Rows that it must have.

    Raises:
        JournalError: The journal was refused, or cannot be read.
    """
    journal = Journal.open(path)
    try:
        await journal.append([row("after", 0, 0)])
        with JournalReader(path) as reader:
            found = {stored.sequence: stored for stored in reader.read()}
    finally:
        with suppress(JournalError):
            await journal.close()
    return sum(found.get(stored.sequence) != stored for stored in rows)


def check_sound(path: Path) -> None:
    """Raise `Unmet` unless `verify` finds nothing in a journal, and `JournalError` if there is none."""
    verified = verify(path)
    if not verified.sound:
        raise Unmet(f"verify finds: {'; '.join(verified.problems)}")
