"""An attack per role: what the table of keys does not give is tried through a real router, and has no effect."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from pcmrs.bus import KEYS
from pcmrs.bus.access import access_control, roles_as_markdown
from pcmrs.bus.declare import declare_publisher, declare_subscriber
from pcmrs.bus.qos import class_of
from pcmrs.clock import SystemClock
from pcmrs.messages.identity import EVERY_CELL, ROLES, Role
from pcmrs.pki import Authority
from pcmrs.testing.daemon import free_port
from tests import ROOT

NAMES: dict[str, Role] = {f"{role[:3]}1": role for role in ROLES if role != "router"}

HERE, ELSEWHERE = "pcmrs/lab/c1", "pcmrs/lab/c2"

PATIENCE = 10.0

QUIET = 1.0
"""Nothing that is allowed takes so long on loopback, s: what has not come by then does not come."""

DOINGS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "query": (("query",), ("serve",)),
    "put": (("put",), ("hear",)),
    "put or query": (("put", "query"), ("hear", "serve")),
    "subscribe": (("hear",), ("put",)),
}
"""Use of a key to what users and owners do."""

Tried = set[tuple[str, str, str]]
"""Name, action, key."""


def concrete(key: str, user: str) -> str:
    for part in ("branch", "operation", "device", "body", "component"):
        key = key.replace(f"<{part}>", "x")
    return key.replace("<user>", user)


def allowed() -> Tried:
    """What the table says, once more: a user asks, sends or hears; an owner answers, hears or sends."""
    found: Tried = set()
    for row in KEYS:
        for name, role in NAMES.items():
            as_user, as_owner = DOINGS[row.use]
            if row.key.startswith("alive/"):
                as_user, as_owner = (), ("live",)
            if role in row.users:
                found |= {(name, action, f"{HERE}/{concrete(row.key, name)}") for action in as_user}
            if role in row.owners:
                for user in NAMES:
                    found |= {(name, action, f"{HERE}/{concrete(row.key, user)}") for action in as_owner}
    return found


def keys() -> list[str]:
    """Every key for every user, in this cell and another, and some that are in no table."""
    rows = sorted({concrete(row.key, user) for row in KEYS for user in NAMES})
    others = ["state/secret", "svc/other", "dev/robot", "cmd/ope1/robot", "video/room", "@/router/local"]
    return [f"{cell}/{key}" for cell in (HERE, ELSEWHERE) for key in (*rows, *others)]


class Lab:
    """A router with access control, and one session for each role."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        now = SystemClock().wall()
        authority = Authority.init(folder / "pki", "lab", now)
        for name, role in {**NAMES, "gate": "router"}.items():
            hosts = ("127.0.0.1",) if role in ("daemon", "router") else ()
            authority.issue(role, name, now, hosts=hosts, cells=["lab/c1"], into=folder)
        authority.issue("router", "far", now, hosts=("127.0.0.1",), cells=["lab/c1"], into=folder)
        for name, cell in (("tom1", "lab/*"), ("ray1", "lab/c1"), ("eva1", "lab/c2")):
            authority.issue("teleoperator", name, now, cells=[cell], via=["far"], into=folder)
        authority.revoke("ray1", now)
        self._folder, self._endpoint = folder, f"tls/127.0.0.1:{free_port()}"
        self.router = self._open("gate", "router", access_control(authority.identities()))
        stack.callback(self.router.close)
        self.sessions = {name: self._open(name, "client") for name in NAMES}
        for session in self.sessions.values():
            stack.callback(session.close)

        self.far = self._open("far", "client")
        stack.callback(self.far.close)

    def _open(self, name: str, mode: str, access: dict[str, Any] | None = None) -> zenoh.Session:
        own = self._folder / name
        files = {"certificate": str(own / f"{name}.pem"), "private_key": str(own / f"{name}.key")}
        pair = {f"{way}_{what}": file for way in ("listen", "connect") for what, file in files.items()}
        values = {
            "mode": mode,
            "listen/endpoints": [self._endpoint] if mode == "router" else [],
            "connect/endpoints": [] if mode == "router" else [self._endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "scouting/delay": 0,
            "transport/shared_memory/enabled": False,
            "transport/link/tls": {"root_ca_certificate": str(own / "ca.pem"), "enable_mtls": True, **pair},
        }
        if access is not None:
            values["access_control"] = access
        config = zenoh.Config()
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield Lab(tmp_path_factory.mktemp("lab"), stack)


def gather(found: Tried, wanted: Callable[[], Tried]) -> Tried:
    """Waits until all that is wanted has come, and then for what should not come."""
    end = time.monotonic() + PATIENCE
    while not wanted() <= found and time.monotonic() < end:
        time.sleep(0.02)
    time.sleep(QUIET)
    return set(found)


def check(tried: str, found: Tried) -> None:
    expected = {each for each in allowed() if each[1] == tried}
    assert gather(found, lambda: expected) == expected


def test_put_rights_match_the_table(lab: Lab) -> None:
    found: Tried = set()
    heard: Any = lab.router.declare_subscriber(
        "pcmrs/**", lambda sample: found.add((sample.payload.to_string(), "put", str(sample.key_expr)))
    )
    for name, session in lab.sessions.items():
        for key in keys():
            session.put(key, name)
    check("put", found)
    heard.undeclare()


def test_query_rights_match_the_table(lab: Lab) -> None:
    found: Tried = set()

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, b"yes")

    serving: Any = lab.router.declare_queryable("pcmrs/**", answer, complete=True)
    for name, session in lab.sessions.items():
        for key in keys():

            def take(reply: zenoh.Reply, name: str = name, key: str = key) -> None:
                if reply.ok is not None:
                    found.add((name, "query", key))

            session.get(key, take, timeout=PATIENCE)
    check("query", found)
    serving.undeclare()


def test_a_router_speaks_only_for_people_who_are_marked_with_it(lab: Lab) -> None:
    found: Tried = set()

    def answer(query: zenoh.Query) -> None:
        with query:
            found.add(("far", "query", str(query.key_expr)))

    heard: Any = lab.router.declare_subscriber(
        "pcmrs/**", lambda sample: found.add(("far", "put", str(sample.key_expr)))
    )
    serving: Any = lab.router.declare_queryable("pcmrs/**", answer, complete=True)
    for user in ("local", "far", *NAMES, "ray1", "eva1", "nobody", "tom1"):
        for cell in (HERE, ELSEWHERE):
            for key in ("cmd/<user>/x/x", "cmd/<user>/lease/take_over", "stop/<user>", "teleop/<user>", "scene/<user>"):
                lab.far.put(f"{cell}/{concrete(key, user)}", b"{}")
                lab.far.get(f"{cell}/{concrete(key, user)}", lambda _: None, timeout=PATIENCE)
    commands = {f"{HERE}/cmd/tom1/x/x", f"{HERE}/cmd/tom1/lease/take_over", f"{HERE}/stop/tom1"}
    expected = {("far", action, key) for action in ("put", "query") for key in commands}
    expected.add(("far", "put", f"{HERE}/teleop/tom1"))
    assert gather(found, lambda: expected) == expected
    heard.undeclare()
    serving.undeclare()


def test_at_a_router_are_only_people_who_are_marked_with_it(tmp_path: Path) -> None:
    now = SystemClock().wall()
    authority = Authority.init(tmp_path / "pki", "lab", now)
    for role in ("router", "daemon"):
        authority.issue(role, f"{role}1", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=tmp_path)
    for name, via in (("anna", ("router1",)), ("bob", ("router2",)), ("eve", ())):
        authority.issue("operator", name, now, via=via, cells=EVERY_CELL, into=tmp_path)
    names = [each["id"] for each in access_control(authority.identities(), router="router1")["subjects"]]
    assert names == ["router1", "daemon1", "anna"]


def test_subscribe_rights_match_the_table(lab: Lab) -> None:
    found: Tried = set()
    hearing: list[Any] = []
    for name, session in lab.sessions.items():
        for key in (*keys(), "**", f"{HERE}/**", "pcmrs/lab/*/state/fsm"):

            def take(sample: zenoh.Sample, name: str = name) -> None:
                found.add((name, "hear", str(sample.key_expr)))

            hearing.append(session.declare_subscriber(key, take))
    expected = {each for each in allowed() if each[1] == "hear"}
    end = time.monotonic() + PATIENCE
    while not expected <= found and time.monotonic() < end:  # until the last declaration has arrived
        for key in keys():
            lab.router.put(key, b"news")
        time.sleep(0.1)
    check("hear", found)
    for each in hearing:
        each.undeclare()


def test_queryable_rights_match_the_table(lab: Lab) -> None:
    found: Tried = set()
    serving: list[Any] = []
    for name, session in lab.sessions.items():
        for key in keys():

            def answer(query: zenoh.Query, name: str = name) -> None:
                with query:
                    query.reply(query.key_expr, name.encode())

            serving.append(session.declare_queryable(key, answer))
    expected = {each for each in allowed() if each[1] == "serve"}
    end = time.monotonic() + PATIENCE
    while not expected <= found and time.monotonic() < end:
        for key in keys():
            for reply in lab.router.get(key, target=zenoh.QueryTarget.ALL, timeout=2.0):
                if reply.ok is not None:
                    found.add((reply.ok.payload.to_string(), "serve", key))
    check("serve", found)
    for each in serving:
        each.undeclare()


def test_liveliness_rights_match_the_table(lab: Lab) -> None:
    tokens: list[Any] = [
        session.liveliness().declare_token(f"{cell}/alive/x")
        for cell in (HERE, ELSEWHERE)
        for session in lab.sessions.values()
    ]
    expected = {key for _, action, key in allowed() if action == "live"}
    seen: set[str] = set()
    end = time.monotonic() + PATIENCE
    while not expected <= seen and time.monotonic() < end:  # until the last token has arrived
        seen = {str(reply.ok.key_expr) for reply in lab.router.liveliness().get("pcmrs/**", timeout=2.0) if reply.ok}
    assert seen == expected
    for token in tokens:
        token.undeclare()


def test_allowed_senders_learn_of_the_daemons_declaration(lab: Lab) -> None:
    """The daemon hears or serves all users by one declaration; a session that is not told of it sends nothing more."""
    daemon = lab.sessions["dae1"]
    senders: list[tuple[str, str, Any]] = []
    declared: list[Any] = []
    for row in (row for row in KEYS if "daemon" in row.owners and row.use != "subscribe" and "<user>" in row.key):
        served = f"{HERE}/{re.sub('<[a-z]+>', '*', row.key)}"
        for role in (role for role in row.users if role != "daemon"):
            key = f"{HERE}/{concrete(row.key, role[:3] + '1')}"
            session = lab.sessions[role[:3] + "1"]
            if "put" in row.use:
                declared.append(daemon.declare_subscriber(served, lambda _: None))
                senders.append((key, "put", session.declare_publisher(key)))
            if "query" in row.use:
                declared.append(daemon.declare_queryable(served, lambda _: None))
                senders.append((key, "query", session.declare_querier(key)))
    end, deaf = time.monotonic() + PATIENCE, senders
    while deaf and time.monotonic() < end:
        time.sleep(0.05)
        deaf = [each for each in deaf if not each[2].matching_status.matching]
    assert len(senders) > 8
    assert not deaf
    for each in (*(sender for *_, sender in senders), *declared):
        each.undeclare()


def test_a_viewer_who_comes_late_is_given_the_last_snapshot(lab: Lab) -> None:
    key = f"{HERE}/state/fsm"
    publisher: Any = declare_publisher(lab.sessions["dae1"], key, class_of("state/fsm"))
    publisher.put(b"last")
    found: Tried = set()

    def take(sample: zenoh.Sample) -> None:
        found.add(("vie1", "hear", sample.payload.to_string()))

    late: Any = declare_subscriber(lab.sessions["vie1"], key, class_of("state/fsm"), take)
    assert gather(found, lambda: {("vie1", "hear", "last")}) == {("vie1", "hear", "last")}
    late.undeclare()
    publisher.undeclare()


def test_table_never_gives_dangerous_rights() -> None:
    """The table itself could be wrong: a viewer only looks, and nobody but the daemon speaks to devices."""
    given = {(NAMES[name], action, key.removeprefix(f"{HERE}/")) for name, action, key in allowed()}
    viewer = {key.partition("/")[0] for role, action, key in given if role == "viewer" and action in ("put", "query")}
    assert viewer == {"stop", "svc"}
    to_devices = {
        role for role, action, key in given if key in ("dev/x/cmd", "dev/robot/setpoint") and action in ("put", "query")
    }
    assert to_devices == {"daemon"}


def test_the_documentation_has_the_table_of_roles() -> None:
    assert roles_as_markdown() in (ROOT / "docs" / "access.md").read_text()
