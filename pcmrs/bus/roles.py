"""The table of roles and keys for people, from the one that the access control is made of."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.bus.keys import KEYS, KeyInfo
from pcmrs.messages.roles import ROLES, Role


def roles_as_markdown() -> str:
    """One row for each key, one column for each role but the router's: what it does there."""
    columns = [role for role in ROLES if role != "router"]
    head = ["| key | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    rows = [f"| `{row.key}` | " + " | ".join(_cell(row, role) for role in columns) + " |" for row in KEYS]
    return "\n".join([*head, *rows]) + "\n"


def _cell(row: KeyInfo, role: Role) -> str:
    return ", ".join(_doings(row, role))


def _doings(row: KeyInfo, role: Role) -> Iterator[str]:
    is_stream, is_token = row.use == "subscribe", row.key.startswith("alive/")
    if role in row.owners:
        yield "is there" if is_token else "sends" if is_stream else "answers" if "query" in row.use else "hears"
    if role in row.users:
        yield "sees" if is_token else "hears" if is_stream else "asks" if "query" in row.use else "sends"
