"""Reading the journal over the bus."""

from __future__ import annotations

from typing import Any

from pcmrs.messages.base import Message


class JournalQuery(Message, frozen=True, kw_only=True):
    """Asks for rows of the journal after sequence `after`, at most `limit`."""

    after: int = 0
    limit: int = 100


class JournalPage(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Rows of the journal as plain data, oldest first."""

    rows: list[dict[str, Any]]
