"""Reading the journal over the bus."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message


class JournalQuery(Message, frozen=True, kw_only=True):
    """Asks for rows of the journal.

    Attributes:
        after: Only those with a larger sequence.
        before: Only those with a smaller one, and of these the last ones; None for the first ones of all.
        limit: At most so many. A page may have fewer, since it has a largest size; where it has none there are no more.
    """

    after: int = 0
    before: int | None = None
    limit: int = 100


class JournalPage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Rows of the journal as plain data, oldest first."""

    rows: list[dict[str, Any]]
