"""A cell and a teleoperator, each behind its own NAT, and a router between them, in network namespaces of this machine.

    cell -- nat-cell -- router -- nat-remote -- remote

Both inner networks have the same private addresses, as two sites often do. The NATs pass connections from inside and
the answers to them; they drop all other packets from outside. The router's namespace also forwards packets between the
two NATs, as the Internet does: an unreachable address is blocked by a NAT, not by a missing route.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final, Literal

from pcmrs.testing.needs import ROOT, Need, program
from pcmrs.testing.networks import Namespaces, ip, namespaces, run_quietly

__all__ = ["GATEWAY", "INSIDE", "NEEDS", "OUTSIDE", "ROUTER", "SIDES", "NatLab", "Place", "Side", "missing", "nat_lab"]

Side = Literal["cell", "remote"]
"""Site behind a NAT."""
Place = Literal["cell", "remote", "router"]
"""Place at which a process runs: a site, or the router between them."""

SIDES: Final[tuple[Side, ...]] = ("cell", "remote")
"""Both sites."""
INSIDE: Final = "192.168.1.2"
"""Address of the cell, and of the remote, each behind its NAT."""
GATEWAY: Final = "192.168.1.1"
"""Address of each NAT on its inner network."""
ROUTER: Final[dict[Side, str]] = {"cell": "198.51.100.1", "remote": "203.0.113.1"}
"""Address of the router as each side dials it."""
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
    """Return whether this process may make a network namespace with the rules of a NAT; it tries one."""
    try:
        with namespaces(["nat"]) as name:
            _nft(f"{name}-nat", NAT + _lossy(0.5))
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


NEEDS: Final = (ROOT, program("ip"), program("nft"), Need("network namespaces with NAT and loss", _namespaces))
"""Requirements of `nat_lab` on this machine."""


def missing() -> str:
    """Return the reason for which a test is skipped: what this machine lacks for a lab; empty if nothing."""
    return next((f"no {need.name}" for need in NEEDS if not need.is_met()), "")


class NatLab(Namespaces[Place]):
    """The five namespaces; use `nat_lab`."""

    def lose(self, side: Side, share: float) -> None:
        """Drop a share of the packets between a side and the router, each way, in place of earlier impairments.

        Args:
            side: Side of the link.
            share: Share of packets between 0 and 1.
        """
        self._set_rule(side, _lossy(share))

    def cut(self, side: Side) -> None:
        """Drop every packet of a side, each way, without closing anything, like a pulled cable."""
        self._set_rule(side, "add rule inet weather forward drop")

    def restore(self, side: Side) -> None:
        """Drop no more packets; the NAT still knows its connections."""
        self._set_rule(side, "")

    def _set_rule(self, side: Side, rule: str) -> None:
        _nft(f"{self.name}-nat-{side}", f"flush chain inet weather forward\n{rule}\n")


@contextmanager
def nat_lab() -> Iterator[NatLab]:
    """Make the namespaces for the length of the context, and end all processes that were started in them.

    Raises:
        subprocess.CalledProcessError: This machine does not permit them; call `missing` first.
    """
    with namespaces(["router", *SIDES, *(f"nat-{side}" for side in SIDES)]) as name:
        for side in SIDES:
            _wire(name, side)
        _forward(f"{name}-router")
        with ExitStack() as processes:
            yield NatLab(name, processes)


def _wire(name: str, side: Side) -> None:
    """Connect the two links of a side, and set up its NAT."""
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
