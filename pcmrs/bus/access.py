"""Who may use which key: Zenoh's access control, made from the one table of keys; what is not in it is denied.

Zenoh looks at every message that passes a router: from a peer (ingress) and to it (egress). Somebody who subscribes
to more than is theirs gets nothing, for a rule has to include the whole key expression.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from pcmrs.bus.keys import KEYS, KeyInfo
from pcmrs.bus.qos import class_of
from pcmrs.messages.identity import EVERY_CELL, LOCAL, Identity
from pcmrs.messages.roles import PEOPLE, Role

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


def access_control(members: Iterable[Identity], *, on_site: bool = False) -> dict[str, Any]:
    """The value of Zenoh's ``access_control``: what each member's role may do under the member's own name.

    Args:
        members: Everybody whose certificate counts; others are connected to nothing.
        on_site: Whether those who come over loopback without a certificate are `LOCAL`: operator and devices there.
    """
    access = _Access()
    for member in members:
        if member.revoked is None:
            access.add({"cert_common_names": [member.name]}, member.name, [member.role], member.cells)
    if on_site:
        access.add({"interfaces": ["lo"], "link_protocols": ["tcp"]}, LOCAL, ROLES_ON_SITE, EVERY_CELL)
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

    def add(self, subject: dict[str, Any], name: str, roles: Iterable[Role], cells: Iterable[str]) -> None:
        own = list(_rules(name, roles, cells))
        self.rules += own
        self.subjects.append({"id": name, **subject})
        self.policies.append({"subjects": [name], "rules": [rule["id"] for rule in own]})


def _rules(name: str, roles: Iterable[Role], cells: Iterable[str]) -> Iterator[dict[str, Any]]:
    """One rule for each direction and set of messages, over all keys to which it applies."""
    keys: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for way in (way for role in roles for way in _ways(name, role)):
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
            "key_exprs": [f"pcmrs/{cell}/{key}" for cell in cells for key in dict.fromkeys(expressions)],
        }


def _ways(name: str, role: Role) -> Iterator[_Way]:
    """What a role does; a router carries what its people do, under whatever names it has let in."""
    user, roles = ("*", set(PEOPLE)) if role == "router" else (name, {role})
    for row in KEYS:
        if roles & {*row.users}:
            yield from _as_user(row, _expression(row.key, user))
        if roles & {*row.owners}:
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
