"""A cell and a teleoperator, each behind a NAT of its own, and a router between them: namespaces of this machine.

    cell -- nat-cell -- router -- nat-remote -- remote

Both insides have the same private network, as two places often do. The NATs let out what begins inside, and the
answers to it back in; whatever else comes from outside is dropped. The router's namespace also passes packets on
between the two NATs, as the Internet does: what cannot be reached is kept out by a NAT, not by a missing way.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final, Literal

from pcmrs_lab.campaign.needs import ROOT, Need, program
from pcmrs_lab.campaign.networks import Namespaces, ip, namespaces, run_quietly

Side = Literal["cell", "remote"]
Place = Literal["cell", "remote", "router"]

SIDES: Final[tuple[Side, ...]] = ("cell", "remote")
INSIDE: Final = "192.168.1.2"
"""Address of the cell, and of the remote, each behind its NAT."""
GATEWAY: Final = "192.168.1.1"
ROUTER: Final[dict[Side, str]] = {"cell": "198.51.100.1", "remote": "203.0.113.1"}
"""The router's address as each side dials it."""
OUTSIDE: Final[dict[Side, str]] = {"cell": "198.51.100.2", "remote": "203.0.113.2"}
"""Address of each NAT as others see it."""

NAT: Final = """
table ip nat {
    chain postrouting { type nat hook postrouting priority srcnat; oifname "wan" masquerade; }
}
table inet filter {
    chain input { type filter hook input priority filter; policy drop; ct state established,related accept; }
    chain forward {
        type filter hook forward priority filter; policy drop;
        ct state established,related accept
        iifname "lan" oifname "wan" accept
    }
}
table inet weather {
    chain forward { type filter hook forward priority filter - 10; }
}
"""


def _namespaces() -> bool:
    """Whether this process may make a network namespace with the rules that a NAT needs; tried once with one."""
    try:
        with namespaces(["nat"]) as name:
            _nft(f"{name}-nat", NAT + _lossy(0.5))
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


NEEDS: Final = (ROOT, program("ip"), program("nft"), Need("network namespaces with NAT and loss", _namespaces))


def missing() -> str:
    """What this machine lacks for a lab, or nothing: the reason for which a test is skipped."""
    return next((f"no {need.name}" for need in NEEDS if not need.is_met()), "")


class NatLab(Namespaces[Place]):
    """The five namespaces; use `nat_lab`."""

    def lose(self, side: Side, share: float) -> None:
        """Drops that share of the packets between a side and the router, each way, in place of what was before."""
        self._weather(side, _lossy(share))

    def cut(self, side: Side) -> None:
        """Drops every packet of a side, each way; nothing is closed or told, as when a cable is pulled."""
        self._weather(side, "add rule inet weather forward drop")

    def mend(self, side: Side) -> None:
        """Drops no more packets; the NAT still knows its connections."""
        self._weather(side, "")

    def _weather(self, side: Side, rule: str) -> None:
        _nft(f"{self.name}-nat-{side}", f"flush chain inet weather forward\n{rule}\n")


@contextmanager
def nat_lab() -> Iterator[NatLab]:
    """Makes the namespaces, and ends all that was started in them.

    Raises:
        subprocess.CalledProcessError: This machine does not permit them: ask `missing` first.
    """
    with namespaces(["router", *SIDES, *(f"nat-{side}" for side in SIDES)]) as name:
        for side in SIDES:
            _wire(name, side)
        _forward(f"{name}-router")
        with ExitStack() as processes:
            yield NatLab(name, processes)


def _wire(name: str, side: Side) -> None:
    """Lays the two cables of a side, and sets up its NAT."""
    inner, nat, router = f"{name}-{side}", f"{name}-nat-{side}", f"{name}-router"
    ip("link", "add", "lan", "netns", inner, "type", "veth", "peer", "lan", "netns", nat)
    ip("link", "add", "wan", "netns", nat, "type", "veth", "peer", side, "netns", router)
    for place, link, address in (
        (inner, "lan", INSIDE),
        (nat, "lan", GATEWAY),
        (nat, "wan", OUTSIDE[side]),
        (router, side, ROUTER[side]),
    ):
        ip("-n", place, "address", "add", f"{address}/24", "dev", link)
        ip("-n", place, "link", "set", link, "up")
    ip("-n", inner, "route", "add", "default", "via", GATEWAY)
    ip("-n", nat, "route", "add", "default", "via", ROUTER[side])
    _forward(nat)
    _nft(nat, NAT)


def _lossy(share: float) -> str:
    return f"add rule inet weather forward numgen random mod 1000 < {round(share * 1000)} drop\n"


def _forward(namespace: str) -> None:
    run_quietly(["ip", "netns", "exec", namespace, "sh", "-c", "echo 1 >/proc/sys/net/ipv4/ip_forward"])


def _nft(namespace: str, rules: str) -> None:
    run_quietly(["ip", "netns", "exec", namespace, "nft", "-f", "-"], rules)
