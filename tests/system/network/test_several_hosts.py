"""A recorder on another machine beside a 3D Slicer on the daemon's own, which does not sign."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from pcmrs.testing.daemon import own_settings, running_daemon
from pcmrs.testing.networks import ADDRESSES, NEEDS, Machine, Namespaces, lan
from pcmrs.testing.plan import example_plan, read_plan
from tests import ROOT
from tests.unit.gateway.signed_room import peer

WHY = next((f"no {need.name}" for need in NEEDS if not need.is_met()), "")

pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(WHY), reason=WHY)]

UNSIGNED = """
import socket, sys
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
    link.settimeout(10.0)
    link.sendto(sys.argv[3].encode(), (sys.argv[1], int(sys.argv[2])))
    print(link.recv(1024).decode())
"""
"""Sends one command as the modules of 3D Slicer do, and prints the answer."""

RECORDER = """
import socket, sys
sys.path.insert(0, sys.argv[4])
from pcmrs_signer import Signer, read_key
signer = Signer("recorder", read_key(sys.argv[3]))
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
    link.settimeout(10.0)
    place = (sys.argv[1], int(sys.argv[2]))
    link.sendto(b"save_planandreal_#1;", place)
    for command in (b"save_planandreal_#2;", b"execute_homexxxx_#3;"):
        link.sendto(signer.sign(command), place)
        print(link.recv(1024).decode())
"""
"""Logs poses, first unsigned, then signed, and asks for a motion; prints all answers."""


LANDMARKS = [msgspec.to_builtins(each) for each in read_plan(example_plan("ratms")).landmarks]
REGISTERED = (
    ("registration.plan_landmarks", json.dumps({"landmarks": LANDMARKS})),
    ("digitization.digitize_all", "{}"),
    ("registration.register", "{}"),
)
"""What makes a registration, without which no pose is logged."""


@pytest.fixture
def machines() -> Iterator[Namespaces[Machine]]:
    with lan() as made:
        yield made


async def test_remote_recorder_works_beside_a_local_slicer(machines: Namespaces[Machine], tmp_path: Path) -> None:
    peer(tmp_path, "recorder")
    settings = [
        *own_settings(tmp_path / "cell", "hosts"),
        f"gateway.mep.host={ADDRESSES['cell']}",
        f"gateway.peers.recorder.key_file={tmp_path / 'recorder.key'}",
        'gateway.peers.recorder.allow=["record"]',
    ]
    async with running_daemon(settings, tmp_path / "log", prefix=machines.prefix("cell")) as daemon:
        planner, mep = daemon.ready.links["planner"], daemon.ready.links["mep"]
        assert (planner[0], mep[0]) == ("127.0.0.1", ADDRESSES["cell"])
        ask = (sys.executable, "-c", UNSIGNED, planner[0], str(planner[1]), "rob_conn_onxxxxx_#7;")
        _, site, cell = daemon.ready.prefix.split("/")
        ready = ("--endpoint", daemon.ready.endpoint, "--site", site, "--cell", cell)
        for operation, arguments in REGISTERED:
            call = (sys.executable, "-m", "pcmrs.cli", "call", operation, arguments, *ready)
            called = await asyncio.to_thread(machines.run, "cell", *call, timeout=60.0)
            assert called.stdout.startswith("accepted"), called.stderr
        slicer = await asyncio.to_thread(machines.run, "cell", *ask, timeout=30.0)
        assert slicer.stdout.startswith("7_accepted"), slicer.stderr
        record = (sys.executable, "-c", RECORDER, mep[0], str(mep[1]), str(tmp_path / "recorder.key"))
        recorder = await asyncio.to_thread(
            machines.run, "other", *record, str(ROOT / "clients" / "python"), timeout=30.0
        )
        answers = recorder.stdout.split()
        assert [answer.split("_")[:2] for answer in answers] == [["2", "accepted"], ["3", "rejected"]], recorder.stderr
        assert answers[1].endswith("not_allowed;")
        async with asyncio.timeout(60.0):
            while not list((tmp_path / "cell" / "records").glob("poses_*.csv")):  # noqa: ASYNC110 - another process
                await asyncio.sleep(0.2)
