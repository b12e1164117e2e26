"""The lab of namespaces is what it says: out by both NATs, in by none, with weather on either side."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import pytest

from pcmrs.testing.natlab import INSIDE, OUTSIDE, ROUTER, SIDES, NatLab, Place, Side, missing, nat_lab
from tests.system.network.programs import python, said

PORT = "7449"
PLACES: tuple[Place, ...] = ("router", *SIDES)
WHY = missing()

pytestmark = pytest.mark.skipif(bool(WHY), reason=WHY)

ECHO = """
import socket, sys, threading
tcp, udp = socket.create_server(("", int(sys.argv[1]))), socket.socket(type=socket.SOCK_DGRAM)
udp.bind(("", int(sys.argv[1])))
def answer(connection, address):
    connection.sendall(f"{address[0]}\\n".encode())
    while data := connection.recv(1024):
        connection.sendall(data)
def datagrams():
    while True:
        udp.sendto(*udp.recvfrom(1024))
threading.Thread(target=datagrams, daemon=True).start()
print("ready", flush=True)
while True:
    threading.Thread(target=answer, args=tcp.accept(), daemon=True).start()
"""
"""Tells over TCP by which address it is reached, and returns whatever comes."""

ASK = """
import socket, sys
with socket.create_connection((sys.argv[1], int(sys.argv[2])), 1.0) as connection:
    print(connection.recv(1024).decode().strip())
"""

DATAGRAMS = """
import socket, sys
udp, answered = socket.socket(type=socket.SOCK_DGRAM), 0
udp.settimeout(0.02)  # few are under way at a time, so that no buffer overflows
for number in range(int(sys.argv[3])):
    udp.sendto(b"%d" % number, (sys.argv[1], int(sys.argv[2])))
    try:
        answered += bool(udp.recv(1024))
    except TimeoutError:
        pass
udp.settimeout(0.5)
try:
    while udp.recv(1024):
        answered += 1
except TimeoutError:
    print(answered)
"""

TALK = """
import socket, sys
connection = socket.create_connection((sys.argv[1], int(sys.argv[2])))
lines = connection.makefile("rw")
print(lines.readline(), end="", flush=True)
for line in sys.stdin:
    print(line, end="", file=lines, flush=True)
    print(lines.readline(), end="", flush=True)
"""


@pytest.fixture
def lab() -> Iterator[NatLab]:
    """With somebody who answers at all three places."""
    with nat_lab() as made:
        for place in PLACES:
            server = python(made, place, ECHO, PORT)
            assert said(server) == "ready"
        yield made


def ask(lab: NatLab, place: Place, address: str) -> str:
    return lab.run(place, sys.executable, "-c", ASK, address, PORT).stdout.strip()


def datagrams(lab: NatLab, place: Place, address: str, count: int) -> int:
    return int(lab.run(place, sys.executable, "-c", DATAGRAMS, address, PORT, str(count)).stdout)


@pytest.mark.parametrize("side", SIDES)
def test_each_side_reaches_the_router_from_its_nat_address(lab: NatLab, side: Side) -> None:
    assert ask(lab, side, ROUTER[side]) == OUTSIDE[side]
    assert datagrams(lab, side, ROUTER[side], 10) == 10


@pytest.mark.parametrize("side", SIDES)
def test_nothing_reaches_a_side_from_outside(lab: NatLab, side: Side) -> None:
    other: Side = "remote" if side == "cell" else "cell"
    # Somebody between the two would know a way to the inside.
    lab.run("router", "ip", "route", "add", f"{INSIDE}/32", "via", OUTSIDE[side])
    tries: list[tuple[Place, str]] = [(other, OUTSIDE[side]), ("router", OUTSIDE[side]), ("router", INSIDE)]

    assert [ask(lab, place, address) for place, address in tries] == ["", "", ""]
    assert [datagrams(lab, place, address, 3) for place, address in tries] == [0, 0, 0]
    assert ask(lab, side, INSIDE) == INSIDE  # there is somebody who would have answered


def test_so_many_packets_are_lost_on_one_side_only(lab: NatLab) -> None:
    lab.lose("remote", 0.2)

    assert 0.44 < datagrams(lab, "remote", ROUTER["remote"], 200) / 200 < 0.84  # 0.8², by six standard deviations
    assert datagrams(lab, "cell", ROUTER["cell"], 100) == 100
    lab.restore("remote")
    assert datagrams(lab, "remote", ROUTER["remote"], 100) == 100


def test_cut_link_stalls_and_continues_when_it_is_mended(lab: NatLab) -> None:
    talk = python(lab, "cell", TALK, ROUTER["cell"], PORT)
    assert said(talk) == OUTSIDE["cell"]
    assert talk.stdin is not None

    lab.cut("cell")
    print("kept", file=talk.stdin, flush=True)
    assert ask(lab, "cell", ROUTER["cell"]) == ""
    assert ask(lab, "remote", ROUTER["remote"]) == OUTSIDE["remote"]
    assert talk.poll() is None

    lab.restore("cell")
    assert said(talk) == "kept"


def test_nothing_is_left_behind() -> None:
    with nat_lab() as lab:
        server = python(lab, "cell", ECHO, PORT)

    assert server.returncode is not None
    assert lab.name not in subprocess.run(["ip", "netns"], capture_output=True, text=True, check=True).stdout


def test_the_reason_for_skipping_names_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)

    assert missing() == "no root"
