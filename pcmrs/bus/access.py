"""Access control: who may use which key.

Zenoh's rules are made from the one table of keys. Everything that is not in the table is denied. Zenoh checks each
message that passes a router: from a peer (ingress) and to it (egress). A rule has to include a key expression as a
whole, so a subscription to more than the permitted keys receives nothing.

`roles_as_markdown` shows the same table to readers of the documentation.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Final, NamedTuple

from pcmrs.bus.keys import KEYS, KeyInfo
from pcmrs.bus.qos import class_of
from pcmrs.messages.identity import EVERY_CELL, LOCAL, PEOPLE, ROLES, Identity, Role, shared_cells


def roles_as_markdown() -> str:
    """Return the table of keys and roles: one row for each key, one column for each role but the router's."""
    columns = [role for role in ROLES if role != "router"]
    head = ["| key | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    rows = [f"| `{row.key}` | " + " | ".join(_cell(row, role) for role in columns) + " |" for row in KEYS]
    return "\n".join([*head, *rows]) + "\n"


def _cell(row: KeyInfo, role: Role) -> str:
    return ", ".join(_actions(row, role))


def _actions(row: KeyInfo, role: Role) -> Iterator[str]:
    is_stream, is_token = row.use == "subscribe", row.key.startswith("alive/")
    if role in row.owners:
        yield "is there" if is_token else "sends" if is_stream else "answers" if "query" in row.use else "hears"
    if role in row.users:
        yield "sees" if is_token else "hears" if is_stream else "asks" if "query" in row.use else "sends"


ROLES_ON_SITE: Final[tuple[Role, ...]] = ("operator", "device", "scene", "daemon")
"""Roles of processes on the cell's own machine, without certificates.

They are consoles, device nodes, detectors, and helpers of the daemon.
"""

_NAMES: Final = re.compile(r"<[a-z]+>")
_QUERY: Final = ("query",)
_SERVE: Final = ("reply", "declare_queryable")
_PUBLISH: Final = ("put", "delete")
_SUBSCRIBE: Final = ("declare_subscriber",)
_WATCH_LIVELINESS: Final = ("declare_liveliness_subscriber", "liveliness_query")
_LIVELINESS: Final = ("liveliness_token",)


class _Permission(NamedTuple):
    """Messages that one member may send and receive on one key expression.

    Attributes:
        ingress: Kinds of message from the member to the router.
        egress: Kinds of message from the router to the member.
        key: Key expression; relative to the cell until `_in_cells` makes it absolute.
    """

    ingress: tuple[str, ...]
    egress: tuple[str, ...]
    key: str


def access_control(members: Iterable[Identity], *, router: str = "", on_site: bool = False) -> dict[str, Any]:
    """Return the value of Zenoh's ``access_control``: each member has the rights of its role under its own name.

    A router has the rights of the people that it carries, each under their own name. These are the members whose
    register entry names the router (`Identity.via`), in the cells that both have.

    Args:
        members: Register: everyone whose certificate is accepted. Others connect, but may use no key.
        router: Name of the router that gets this configuration: it serves only the people whose entry names it. Empty
            for a daemon.
        on_site: True if peers over loopback without a certificate are `LOCAL`: operator, devices and daemon helpers.
    """
    access = _Access()
    valid = [each for each in members if each.revoked is None]
    for member in valid:
        subject = {"cert_common_names": [member.name]}
        if member.role == "router":
            carried = [each for each in valid if each.role in PEOPLE and member.name in each.via]
            access.add(subject, member.name, chain.from_iterable(_carried(each, member) for each in carried))
        elif not router or router in member.via or member.role not in PEOPLE:
            access.add(subject, member.name, _in_cells(member.cells, _permissions(member.name, member.role)))
    if on_site:
        permissions = chain.from_iterable(_permissions(LOCAL, role) for role in ROLES_ON_SITE)
        access.add({"interfaces": ["lo"], "link_protocols": ["tcp"]}, LOCAL, _in_cells(EVERY_CELL, permissions))
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

    def add(self, subject: dict[str, Any], name: str, permissions: Iterable[_Permission]) -> None:
        own = list(_rules(name, permissions))
        if own:  # a subject without rules is denied everything
            self.rules += own
            self.subjects.append({"id": name, **subject})
            self.policies.append({"subjects": [name], "rules": [rule["id"] for rule in own]})


def _rules(name: str, permissions: Iterable[_Permission]) -> Iterator[dict[str, Any]]:
    """Yield one rule for each direction and set of messages, over all keys to which it applies."""
    keys: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for each in permissions:
        for flow, messages in (("ingress", each.ingress), ("egress", each.egress)):
            if not messages:
                continue
            keys.setdefault((flow, messages), []).append(each.key)
    for number, ((flow, messages), expressions) in enumerate(keys.items()):
        yield {
            "id": f"{name}-{number}",
            "permission": "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": list(dict.fromkeys(expressions)),
        }


def _in_cells(cells: Iterable[str], permissions: Iterable[_Permission]) -> Iterator[_Permission]:
    """Return the permissions with absolute keys, in each of the cells."""
    relative = list(permissions)
    return (each._replace(key=f"pcmrs/{cell}/{each.key}") for cell in cells for each in relative)


def _carried(member: Identity, router: Identity) -> Iterator[_Permission]:
    """Return what a router may do for one of the people that it carries."""
    return _in_cells(shared_cells(member.cells, router.cells), _permissions(member.name, member.role))


def _permissions(name: str, role: Role) -> Iterator[_Permission]:
    """Yield what a role may do under a name."""
    for row in KEYS:
        if role in row.users:
            yield from _as_user(row, _expression(row.key, name))
        if role in row.owners:
            yield from _as_owner(row, _expression(row.key, "*"))


def _as_user(row: KeyInfo, key: str) -> Iterator[_Permission]:
    if row.key.startswith("alive/"):
        yield _Permission(_WATCH_LIVELINESS, (*_LIVELINESS, "reply"), key)
    elif row.use == "subscribe":
        yield _Permission(_SUBSCRIBE, _PUBLISH, key)
        if class_of(key).kept:  # a late subscriber, or one that lost a message, queries the publisher's cache
            yield _Permission(
                (*_SUBSCRIBE, *_QUERY, *_WATCH_LIVELINESS), (*_PUBLISH, *_SERVE, *_LIVELINESS), f"{key}/@adv/**"
            )
            yield _Permission((), ("reply",), key)  # replies of the cache carry the key of the data
    else:
        # The receiver declares its interest for all users at once. A sender that never sees this declaration sends
        # nothing.
        declared = _expression(row.key, "*")
        if "query" in row.use:
            yield _Permission(_QUERY, ("reply",), key)
            yield _Permission((), ("declare_queryable",), declared)
        if "put" in row.use:
            yield _Permission(_PUBLISH, (), key)
            yield _Permission((), _SUBSCRIBE, declared)


def _as_owner(row: KeyInfo, key: str) -> Iterator[_Permission]:
    if row.key.startswith("alive/"):
        yield _Permission(_LIVELINESS, _WATCH_LIVELINESS, key)
    elif row.use == "subscribe":
        yield _Permission(_PUBLISH, _SUBSCRIBE, key)
        if class_of(key).kept:
            yield _Permission(
                (*_PUBLISH, *_SERVE, *_LIVELINESS), (*_SUBSCRIBE, *_QUERY, *_WATCH_LIVELINESS), f"{key}/@adv/**"
            )
            yield _Permission(("reply",), (), key)
    else:
        if "query" in row.use:
            yield _Permission(_SERVE, _QUERY, key)
        if "put" in row.use:
            yield _Permission(_SUBSCRIBE, _PUBLISH, key)


def _expression(key: str, name: str) -> str:
    """Return the key expression of a row: its ``<user>`` becomes `name`, all other names match any chunk."""
    return _NAMES.sub("*", key.replace("<user>", name))
