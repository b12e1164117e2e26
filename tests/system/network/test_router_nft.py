"""The shipped rules of the router's machine, loaded in the lab of namespaces."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from pcmrs.testing.natlab import OUTSIDE, ROUTER, NatLab, missing, nat_lab
from tests import ROOT
from tests.system.network.programs import python, said

RULES = ROOT / "deploy" / "router" / "router.nft"
PORT = "7449"
MOST_OPEN = 32
WHY = missing()

pytestmark = pytest.mark.skipif(bool(WHY), reason=WHY)

HELLO = """
import socket, sys
with socket.create_server(("", int(sys.argv[1])), backlog=512) as server:
    print("ready", flush=True)
    kept = []
    while True:
        connection, address = server.accept()
        connection.sendall(address[0].encode())
        kept.append(connection)
"""
"""Greets everybody by address and closes nothing."""

ASK = """
import socket, sys
with socket.create_connection((sys.argv[1], int(sys.argv[2])), 3.0) as connection:
    print(connection.recv(64).decode())
"""

FLOOD = """
import selectors, socket, sys
waiting = selectors.DefaultSelector()
for _ in range(200):
    connection = socket.socket()
    connection.setblocking(False)
    connection.connect_ex((sys.argv[1], int(sys.argv[2])))
    waiting.register(connection, selectors.EVENT_READ)
greeted = set()
while ready := waiting.select(1.0):
    for key, _ in ready:
        greeted.add(key.fileobj)
        waiting.unregister(key.fileobj)
print(len(greeted), flush=True)
sys.stdin.read()
"""
"""Opens 200 connections, tells how many got through when no more do for a second, and holds them."""


@pytest.fixture
def lab() -> Iterator[NatLab]:
    with nat_lab() as made:
        for port in (PORT, "8000"):
            assert said(python(made, "router", HELLO, port)) == "ready"
        yield made


def ask(lab: NatLab, port: str) -> str:
    return lab.run("cell", sys.executable, "-c", ASK, ROUTER["cell"], port).stdout.strip()


def load(lab: NatLab, rules: str) -> None:
    loaded = subprocess.run(
        [*lab.prefix("router"), "nft", "-f", "-"], input=rules, text=True, capture_output=True, check=False
    )
    assert (loaded.returncode, loaded.stderr) == (0, "")


def flooded(lab: NatLab) -> int:
    """Connections of the remote that got through, of 200; they stay."""
    return int(said(python(lab, "remote", FLOOD, ROUTER["remote"], PORT)))


def test_the_router_is_reached_at_its_port_only(lab: NatLab) -> None:
    assert ask(lab, "8000") == OUTSIDE["cell"], "without the rules somebody answers there"

    load(lab, RULES.read_text())

    assert (ask(lab, PORT), ask(lab, "8000")) == (OUTSIDE["cell"], "")


def test_flood_from_one_source_is_limited_and_bars_nobody_else(lab: NatLab) -> None:
    load(lab, RULES.read_text())

    assert flooded(lab) <= MOST_OPEN
    assert ask(lab, PORT) == OUTSIDE["cell"]


def test_without_the_rules_all_of_a_flood_gets_through(lab: NatLab) -> None:
    assert flooded(lab) == 200


def test_open_connections_of_a_source_are_limited_at_any_rate(lab: NatLab) -> None:
    """They may have been opened slowly."""
    load(lab, RULES.read_text().replace("over 4/second burst 5 packets", "over 1000/second burst 1000 packets"))

    assert flooded(lab) == MOST_OPEN
    assert ask(lab, PORT) == OUTSIDE["cell"]


def test_loaded_again_it_replaces_itself_and_nothing_else(lab: NatLab) -> None:
    load(lab, "table inet other { chain input { type filter hook input priority 0; }; }")
    for _ in range(2):
        load(lab, RULES.read_text())

    listed = lab.run("router", "nft", "list", "ruleset").stdout
    assert listed.count("table inet other") == 1
    assert listed.count("hook input") == 2
