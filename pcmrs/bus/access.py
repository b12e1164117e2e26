"""Who may use which key: Zenoh's access control, made from the one table of keys; what is not in it is denied.

Zenoh looks at every message that passes the router: from a peer (ingress) and to it (egress). Somebody who subscribes
to more than is theirs gets nothing, for a rule has to include the whole key expression.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, Final, NamedTuple

import msgspec

from pcmrs.bus.keys import KEYS, KeyInfo
from pcmrs.bus.qos import class_of
from pcmrs.messages.roles import Role

EVERYWHERE: Final = ("*/*",)

_NAMES: Final = re.compile(r"<[a-z]+>")
_ASKING: Final = ("query",)
_ANSWERING: Final = ("reply", "declare_queryable")
_SENDING: Final = ("put", "delete")
_HEARING: Final = ("declare_subscriber",)
_SEEING: Final = ("declare_liveliness_subscriber", "liveliness_query")
_LIVING: Final = ("liveliness_token",)


class Member(msgspec.Struct, frozen=True, kw_only=True):
    """Somebody who has a certificate.

    Attributes:
        name: Its common name.
        role: What it may do.
        cells: Key expressions ``<site>/<cell>`` of the cells in which it may do that.
    """

    name: str
    role: Role
    cells: tuple[str, ...] = EVERYWHERE


class _Way(NamedTuple):
    """Messages from a member and to it, about one key expression."""

    ingress: tuple[str, ...]
    egress: tuple[str, ...]
    key: str


def access_control(members: Iterable[Member]) -> dict[str, Any]:
    """The value of Zenoh's ``access_control``: what each member's role may do under the member's own name.

    Args:
        members: Everybody whose certificate counts; others are connected to nothing.
    """
    rules: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for member in members:
        own = list(_rules(member))
        rules += own
        subjects.append({"id": member.name, "cert_common_names": [member.name]})
        policies.append({"subjects": [member.name], "rules": [rule["id"] for rule in own]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules(member: Member) -> Iterator[dict[str, Any]]:
    """One rule for each direction and set of messages, over all keys to which it applies."""
    keys: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for way in _ways(member):
        for flow, messages in (("ingress", way.ingress), ("egress", way.egress)):
            if not messages:
                continue
            keys.setdefault((flow, messages), []).append(way.key)
    for number, ((flow, messages), expressions) in enumerate(keys.items()):
        yield {
            "id": f"{member.name}-{number}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": [f"pcmrs/{cell}/{key}" for cell in member.cells for key in dict.fromkeys(expressions)],
        }


def _ways(member: Member) -> Iterator[_Way]:
    for row in KEYS:
        if member.role in row.users:
            yield from _as_user(row, _expression(row.key, member.name))
        if member.role in row.owners:
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
        yield _Way(_ASKING, _ANSWERING, key)
        if "put" in row.use:
            yield _Way(_SENDING, _HEARING, key)


def _as_owner(row: KeyInfo, key: str) -> Iterator[_Way]:
    if row.key.startswith("alive/"):
        yield _Way(_LIVING, _SEEING, key)
    elif row.use == "subscribe":
        yield _Way(_SENDING, _HEARING, key)
        if class_of(key).kept:
            yield _Way((*_SENDING, *_ANSWERING, *_LIVING), (*_HEARING, *_ASKING, *_SEEING), f"{key}/@adv/**")
            yield _Way(("reply",), (), key)
    else:
        yield _Way(_ANSWERING, _ASKING, key)
        if "put" in row.use:
            yield _Way(_HEARING, _SENDING, key)


def _expression(key: str, name: str) -> str:
    """The key expression of a row: its ``<user>`` is `name`, all other names are any chunk."""
    return _NAMES.sub("*", key.replace("<user>", name))
