"""Cell that other machines can reach: an authority, people with certificates, and a daemon that listens over TLS."""

from __future__ import annotations

import itertools
import math
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from pcmrs.bus import BusSettings, Credentials
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.messages.identity import EVERY_CELL, Role
from pcmrs.pki import Authority
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.daemon import free_port
from pcmrs_lab.campaign.lab import Lab

PEOPLE: dict[str, Role] = {
    "anna": "operator", "bob": "operator", "ray": "operator",
    "slicer": "planner", "eve": "viewer", "tom": "teleoperator",
}  # fmt: skip
"""Names and roles; tom, and ray who is revoked, are marked with the router `ROUTER`."""
ROUTER = "gate"
CARRIED = "tom"
PEER = "panel"
ELSEWHERE = "zoe"
"""Operator of another cell, who may come through the router, too."""
DAEMON, DEVICE = "daemon1", "arm1"
REVOKED = "ray"
EXPIRED = "old"
FOREIGN = "foreign"
INVALID = "revoked or expired certificate"
DAY = 86400.0


def attacker_of(name: str) -> str:
    """Return the attacker, in the table of attacks, who uses an identity of `People`."""
    special = {
        ROUTER: "router", DAEMON: "daemon", DEVICE: "device", ELSEWHERE: "user of another cell",
        FOREIGN: "unknown client", REVOKED: INVALID, EXPIRED: INVALID,
    }  # fmt: skip
    return special.get(name) or PEOPLE[name]


class People:
    """Everyone who has, or had, a certificate, in a folder.

    Args:
        folder: Folder of the authority and all identities.
        cell: ``<site>/<cell>`` in which they have their roles.
    """

    def __init__(self, folder: Path, cell: str) -> None:
        now = SystemClock().wall()
        self.folder = folder
        self.authority = Authority.init(folder / "pki", "lab", now)
        self.authority.issue("daemon", DAEMON, now, hosts=("127.0.0.1",), cells=(cell,), into=folder)
        self.authority.issue("router", ROUTER, now, hosts=("127.0.0.1",), cells=(cell,), into=folder)
        for name, role in PEOPLE.items():
            via = (ROUTER,) if name in (CARRIED, REVOKED) else ()
            self.authority.issue(role, name, now, cells=(cell,), via=via, into=folder)
        self.authority.issue("device", DEVICE, now, cells=(cell,), into=folder)
        self.authority.issue("operator", ELSEWHERE, now, cells=("other/*",), via=(ROUTER,), into=folder)
        self.authority.issue("operator", EXPIRED, now - 10 * DAY, days=7.0, cells=(cell,), into=folder)
        self.authority.revoke(REVOKED, now)
        other = Authority.init(folder / FOREIGN, "other", now)
        other.issue("operator", "anna", now, cells=(cell,), into=folder / FOREIGN)

    @property
    def register(self) -> Path:
        """Path of the authority's register."""
        return self.authority.folder / "register.json"

    def credentials(self, name: str) -> Credentials:
        """Return the credentials of a person, valid or not; those of `FOREIGN` are anna's of another authority."""
        own, user = (self.folder / FOREIGN / "anna", "anna") if name == FOREIGN else (self.folder / name, name)
        return Credentials(
            name=user,
            cells=EVERY_CELL,
            certificate=str(own / f"{user}.pem"),
            key=str(own / f"{user}.key"),
            authority=str(self.folder / "anna" / "ca.pem"),
            ends=math.inf,
        )


@dataclass(frozen=True)
class ReachableCell:
    """Running cell with access control.

    Attributes:
        cell: Cell of the lab; its own client is on site.
        people: People who may reach it.
        endpoint: Endpoint at which it is dialled.
        peer_key: Key file of the peer `PEER`, who signs string commands.
    """

    cell: RunningCell
    people: People
    endpoint: str
    peer_key: Path

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of the endpoint."""
        host, port = self.endpoint.removeprefix("tls/").split(":")
        return host, int(port)

    def settings(self, name: str) -> BusSettings:
        """Return the bus settings with which a person dials the cell."""
        return BusSettings(endpoint=self.endpoint, cell=self.cell.name, credentials=self.people.credentials(name))

    def signer(self) -> Signer:
        """Return a signer of string commands for the peer."""
        return Signer(PEER, read_key(self.peer_key), itertools.count(1).__next__)

    @asynccontextmanager
    async def client(self, name: str) -> AsyncIterator[Client]:
        """Connect as a person for the length of the context; raise `BusError` if they are not admitted."""
        credentials = self.people.credentials(name)
        async with Client.connect(self.endpoint, cell=self.cell.name, credentials=credentials) as client:
            yield client


@asynccontextmanager
async def reachable_cell(lab: Lab, *overrides: str, prefix: Sequence[str] = ()) -> AsyncIterator[ReachableCell]:
    """Start a cell that is reached over TLS, with everyone of `PEOPLE`, and a peer that signs.

    Args:
        lab: Surroundings of the fault.
        overrides: Further settings, ``key=value`` each.
        prefix: Words before the command line of the daemon.
    """
    folder = Path(tempfile.mkdtemp(dir=lab.folder))
    people = People(folder / "people", "lab/*")
    endpoint, key = f"tls/127.0.0.1:{free_port()}", folder / f"{PEER}.key"
    new_key(key)
    access = (
        f"access.identity={people.folder / 'daemon1'}",
        f"access.register={people.register}",
        f'access.listen=["{endpoint}"]',
        f"gateway.peers.{PEER}.key_file={key}",
    )
    async with lab.daemon(*access, *overrides, prefix=prefix) as cell:
        yield ReachableCell(cell, people, endpoint, key)
