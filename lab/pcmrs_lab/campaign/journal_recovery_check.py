"""Whether a journal that may be damaged is taken up with all its rows, or refused; nothing else is right."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow, verify
from pcmrs.testing.errors import Unmet
from pcmrs.testing.journal import KEY, PUBLIC_KEY, contents
from pcmrs_lab.campaign.writing import row


def taken_up(path: Path, rows: Sequence[StoredRow]) -> bool:
    """Opens and verifies a journal that may be damaged: True when it is taken up with every row, False when refused.

    Raises:
        Unmet: Something is wrong, and nobody says so: rows are missing or others, `verify` finds nothing in what is
            refused, or what was refused was changed.
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
            raise Unmet(f"{missing} rows are missing or others")
        return True
    if sound and KEY not in refusal.text:  # verifying needs no private key
        raise Unmet(f"verify has found nothing, and opening says: {refusal.text}")
    after = contents(path.parent)
    changed = [name for name in before if name != PUBLIC_KEY and after.get(name) != before[name]]
    if changed:
        raise Unmet(f"refused, and changed nevertheless: {', '.join(changed)}")
    return False


async def _refusal(path: Path) -> JournalError | None:
    """Opens and closes a journal as a daemon does; why that is refused."""
    try:
        journal = Journal.open(path)
    except JournalError as error:
        return error
    await journal.close()
    return None


async def missing_rows(path: Path, rows: Iterable[StoredRow]) -> int:
    """How many rows are missing or others, once the journal was taken up as a daemon does, and a row appended.

    Raises:
        JournalError: It was refused, or cannot be read.
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
    """Raises `Unmet` unless `verify` finds nothing in a journal, and `JournalError` where there is none."""
    verified = verify(path)
    if not verified.sound:
        raise Unmet(f"verify finds: {'; '.join(verified.problems)}")
