"""A flood of handshakes at the router's TLS port, from a machine behind another NAT."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pcmrs
from pcmrs.clock import SystemClock
from pcmrs.pki import Authority
from pcmrs.testing.natlab import NEEDS, ROUTER, NatLab, nat_lab
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import FLOODING, record

PORT = 7449
RULES = Path(pcmrs.__file__).parents[1] / "deploy" / "router" / "router.nft"
CONNECTIONS = 200
WITHIN = 1.0
"""Time within which a legitimate client connects, s of the machine."""

ESTABLISHED = "01"
"""State of a connection in the kernel's notation."""

FLOOD = """
import socket, sys, time
held = []
for number in range(int(sys.argv[3])):
    connection = socket.socket()
    connection.setblocking(False)
    connection.connect_ex((sys.argv[1], int(sys.argv[2])))
    held.append(connection)
time.sleep(0.5)
for number, connection in enumerate(held):
    try:
        connection.send(b"garbage" if number % 2 else b"\\x16\\x03\\x01")
    except OSError:
        pass
print("flooded", flush=True)
sys.stdin.read()
"""
"""Opens connections and keeps them open: half send bytes that are not TLS, half begin a handshake and do not continue.
"""

CONNECT = """
import sys, time
from pathlib import Path
from pcmrs.bus import BusSettings
from pcmrs.bus.settings import open_session
from pcmrs.clock import SystemClock
from pcmrs.errors import BusError
from pcmrs.pki import read_credentials
own = read_credentials(Path(sys.argv[2]), SystemClock().wall())
begun = time.monotonic()
while True:
    try:
        session = open_session(BusSettings(endpoint=sys.argv[1], credentials=own))
        break
    except BusError:
        if time.monotonic() - begun > 60.0:
            raise
print(time.monotonic() - begun, flush=True)
session.close()
"""
"""Prints the time that a client needs until it is admitted, with any number of attempts, s."""


@fault(
    "A13",
    how="network namespaces, rules for nftables of deploy/router: 200 connections",
    needs=NEEDS,
    deadline=180.0,
    tries={FLOODING: ["TLS port"]},
)
async def handshake_flood(lab: Lab) -> Evidence:
    """While an attacker holds 200 connections open that are not TLS, a client from elsewhere is admitted."""
    if not RULES.is_file():
        raise NotRun("deploy/router/router.nft is missing: it is part of the source, not of the wheel")
    return await asyncio.to_thread(_flooded, lab.folder)


def _flooded(folder: Path) -> Evidence:
    now = SystemClock().wall()
    authority = Authority.init(folder / "pki", "lab", now)
    authority.issue("router", "gate", now, hosts=tuple(ROUTER.values()), cells=("lab/*",), into=folder)
    authority.issue("operator", "anna", now, via=("gate",), cells=("lab/*",), into=folder)
    with nat_lab() as net:
        _start_router(net, folder)
        unprotected, open_without = _connected_beside_a_flood(net, folder)
        loaded = net.run("router", "nft", "-f", str(RULES))
        expect(loaded.returncode == 0, f"The rules are not loaded: {loaded.stderr}")
        protected, open_with = _connected_beside_a_flood(net, folder)
    expect(unprotected > WITHIN, f"Without the rules, too, the client was admitted after {unprotected:.2f} s.")
    expect(protected < WITHIN, f"The client was admitted after {protected:.2f} s.")
    return Evidence(
        "admitted by the rules of nftables",
        took_place={"open_at_the_router_without_the_rules": open_without},
        control_kind="mutant",
        control={"let_in_without_the_rules_after_s": round(unprotected, 1)},
        details={"let_in_after_s": round(protected, 2), "open_at_the_router_with_the_rules": open_with},
    )


def _connected_beside_a_flood(net: NatLab, folder: Path) -> tuple[float, int]:
    """Return the time until a client is admitted during a flood, s, and the number of connections at the router."""
    pipe, many = subprocess.PIPE, str(0 if is_sham() else CONNECTIONS)
    words = (sys.executable, "-c", FLOOD, ROUTER["remote"], str(PORT), many)
    flood = net.start("remote", *words, stdin=pipe, stdout=pipe)
    _line(flood)
    held = _established(net)
    record(FLOODING, "TLS port")
    taken = _connected(net, folder)
    flood.communicate()
    return taken, held


def _established(net: NatLab) -> int:
    """Return the number of connections at the router's port, as its kernel counts them."""
    lines = [line.split() for line in net.run("router", "cat", "/proc/net/tcp").stdout.splitlines()]
    return sum(line[1].endswith(f":{PORT:04X}") and line[3] == ESTABLISHED for line in lines)


def _start_router(net: NatLab, folder: Path) -> None:
    words = ["router", "--identity", str(folder / "gate"), "--register", str(folder / "pki" / "register.json")]
    router = net.start(
        "router", sys.executable, "-m", "pcmrs.cli", *words, "--listen", f"tls/0.0.0.0:{PORT}", stdout=subprocess.PIPE
    )
    while _line(router) != "ready":
        pass


def _connected(net: NatLab, folder: Path) -> float:
    endpoint = f"tls/{ROUTER['cell']}:{PORT}"
    done = net.run("cell", sys.executable, "-c", CONNECT, endpoint, str(folder / "anna"), timeout=90.0)
    expect(done.returncode == 0, f"The client was not admitted: {done.stderr[-300:]}")
    return float(done.stdout)


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    line = process.stdout.readline()
    expect(bool(line), "The process has ended.")
    return line.strip()
