"""Who may use which key: Zenoh's access control, made from the one table of keys; what is not in it is denied.

Zenoh looks at every message that passes a router: from a peer (ingress) and to it (egress). Somebody who subscribes
to more than is theirs gets nothing, for a rule has to include the whole key expression.

The table of roles and keys for people, from the one that the access control is made of.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from pcmrs.bus.keys import KEYS, KeyInfo
from pcmrs.bus.qos import class_of
from pcmrs.messages.identity import EVERY_CELL, LOCAL, PEOPLE, ROLES, Identity, Role, shared_cells


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


ROLES_ON_SITE: Final[tuple[Role, ...]] = ("operator", "device", "daemon")
"""What runs on the cell's own machine, without certificates: consoles, device nodes, the daemon's own helpers."""

_NAMES: Final = re.compile(r"<[a-z]+>")
_ASKING: Final = ("query",)
_ANSWERING: Final = ("reply", "declare_queryable")
_SENDING: Final = ("put", "delete")
_HEARING: Final = ("declare_subscriber",)
_SEEING: Final = ("declare_liveliness_subscriber", "liveliness_query")
_LIVING: Final = ("liveliness_token",)


class _Way(NamedTuple):
    """Messages from a member and to it, about one key expression."""

    ingress: tuple[str, ...]
    egress: tuple[str, ...]
    key: str


def access_control(members: Iterable[Identity], *, router: str = "", on_site: bool = False) -> dict[str, Any]:
    """The value of Zenoh's ``access_control``: what each member's role may do under the member's own name.

    A router may do what the people may whom it carries, each under their own name: those of the register who are marked
    with it (`Identity.via`), in the cells that both have.

    Args:
        members: Everybody whose certificate counts; others are connected to nothing.
        router: Name of the router whose access this is: it serves only the people marked with it. Empty for a daemon.
        on_site: Whether those who come over loopback without a certificate are `LOCAL`: operator and devices there.
    """
    access = _Access()
    valid = [each for each in members if each.revoked is None]
    for member in valid:
        subject = {"cert_common_names": [member.name]}
        if member.role == "router":
            carried = [each for each in valid if each.role in PEOPLE and member.name in each.via]
            access.add(subject, member.name, (way for each in carried for way in _carried(each, member)))
        elif not router or router in member.via or member.role not in PEOPLE:
            access.add(subject, member.name, _in_cells(member.cells, _ways(member.name, member.role)))
    if on_site:
        ways = (way for role in ROLES_ON_SITE for way in _ways(LOCAL, role))
        access.add({"interfaces": ["lo"], "link_protocols": ["tcp"]}, LOCAL, _in_cells(EVERY_CELL, ways))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": access.rules,
        "subjects": access.subjects,
        "policies": access.policies,
    }


@dataclass
class _Access:
    rules: list[dict[str, Any]] = field(default_factory=list)
    subjects: list[dict[str, Any]] = field(default_factory=list)
    policies: list[dict[str, Any]] = field(default_factory=list)

    def add(self, subject: dict[str, Any], name: str, ways: Iterable[_Way]) -> None:
        own = list(_rules(name, ways))
        if own:  # who has no rules is denied everything
            self.rules += own
            self.subjects.append({"id": name, **subject})
            self.policies.append({"subjects": [name], "rules": [rule["id"] for rule in own]})


def _rules(name: str, ways: Iterable[_Way]) -> Iterator[dict[str, Any]]:
    """One rule for each direction and set of messages, over all keys to which it applies."""
    keys: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for way in ways:
        for flow, messages in (("ingress", way.ingress), ("egress", way.egress)):
            if not messages:
                continue
            keys.setdefault((flow, messages), []).append(way.key)
    for number, ((flow, messages), expressions) in enumerate(keys.items()):
        yield {
            "id": f"{name}-{number}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": list(dict.fromkeys(expressions)),
        }


def _in_cells(cells: Iterable[str], ways: Iterable[_Way]) -> Iterator[_Way]:
    """The ways with absolute keys, in each of the cells."""
    relative = list(ways)
    return (way._replace(key=f"pcmrs/{cell}/{way.key}") for cell in cells for way in relative)


def _carried(member: Identity, router: Identity) -> Iterator[_Way]:
    """What a router does for one of those whom it carries."""
    return _in_cells(shared_cells(member.cells, router.cells), _ways(member.name, member.role))


def _ways(name: str, role: Role) -> Iterator[_Way]:
    """What a role does under a name."""
    for row in KEYS:
        if role in row.users:
            yield from _as_user(row, _expression(row.key, name))
        if role in row.owners:
            yield from _as_owner(row, _expression(row.key, "*"))


def _as_user(row: KeyInfo, key: str) -> Iterator[_Way]:
    if row.key.startswith("alive/"):
        yield _Way(_SEEING, (*_LIVING, "reply"), key)
    elif row.use == "subscribe":
        yield _Way(_HEARING, _SENDING, key)
        if class_of(key).kept:  # what a late or lossy subscriber asks the publisher's cache for
            yield _Way((*_HEARING, *_ASKING, *_SEEING), (*_SENDING, *_ANSWERING, *_LIVING), f"{key}/@adv/**")
            yield _Way((), ("reply",), key)  # what the cache has goes by the key of the data
    else:
        # Who answers or hears declares that for all users at once; a sender who is not told of it sends nothing more.
        declared = _expression(row.key, "*")
        if "query" in row.use:
            yield _Way(_ASKING, ("reply",), key)
            yield _Way((), ("declare_queryable",), declared)
        if "put" in row.use:
            yield _Way(_SENDING, (), key)
            yield _Way((), _HEARING, declared)


def _as_owner(row: KeyInfo, key: str) -> Iterator[_Way]:
    if row.key.startswith("alive/"):
        yield _Way(_LIVING, _SEEING, key)
    elif row.use == "subscribe":
        yield _Way(_SENDING, _HEARING, key)
        if class_of(key).kept:
            yield _Way((*_SENDING, *_ANSWERING, *_LIVING), (*_HEARING, *_ASKING, *_SEEING), f"{key}/@adv/**")
            yield _Way(("reply",), (), key)
    else:
        if "query" in row.use:
            yield _Way(_ANSWERING, _ASKING, key)
        if "put" in row.use:
            yield _Way(_HEARING, _SENDING, key)


def _expression(key: str, name: str) -> str:
    """The key expression of a row: its ``<user>`` is `name`, all other names are any chunk."""
    return _NAMES.sub("*", key.replace("<user>", name))
