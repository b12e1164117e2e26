"""A cell and a teleoperator, each behind a NAT of its own, and a router between them: namespaces of this machine.

    cell -- nat-cell -- router -- nat-remote -- remote

Both insides have the same private network, as two places often do. The NATs let out what begins inside, and the
answers to it back in; whatever else comes from outside is dropped. The router's namespace also passes packets on
between the two NATs, as the Internet does: what cannot be reached is kept out by a NAT, not by a missing way.
"""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final, Literal

from pcmrs.campaign.needs import ROOT, Need, program

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
END_TIME: Final = 5.0

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
    name = f"pcmrs-{uuid.uuid4().hex[:8]}"
    try:
        _ip("netns", "add", name)
    except (OSError, subprocess.CalledProcessError):
        return False
    try:
        _nft(name, NAT + _lossy(0.5))
    except (OSError, subprocess.CalledProcessError):
        return False
    else:
        return True
    finally:
        _ip("netns", "delete", name)


NEEDS: Final = (ROOT, program("ip"), program("nft"), Need("network namespaces with NAT and loss", _namespaces))


def missing() -> str:
    """What this machine lacks for a lab, or nothing: the reason for which a test is skipped."""
    return next((f"no {need.name}" for need in NEEDS if not need.is_met()), "")


class NatLab:
    """The five namespaces; use `nat_lab`.

    Attributes:
        name: Begins the names of all of them.
    """

    def __init__(self, name: str, processes: ExitStack) -> None:
        self.name = name
        self._processes = processes

    def prefix(self, place: Place) -> list[str]:
        """The words before a command line that has it run at `place`."""
        return ["ip", "netns", "exec", f"{self.name}-{place}"]

    def run(self, place: Place, *command: str, timeout: float = 10.0) -> subprocess.CompletedProcess[str]:
        """Runs a command to its end, whatever status that has.

        Raises:
            subprocess.TimeoutExpired: It has not ended after `timeout`, s, and was killed.
        """
        words = [*self.prefix(place), *command]
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout)

    def start(self, place: Place, *command: str, **streams: Any) -> subprocess.Popen[str]:
        """Starts a process that ends with the lab at the latest."""
        process = subprocess.Popen([*self.prefix(place), *command], text=True, **streams)
        self._processes.callback(_end, process)
        return process

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
    name = f"pcmrs-{uuid.uuid4().hex[:8]}"
    with ExitStack() as stack:
        for place in ("router", *SIDES, *(f"nat-{side}" for side in SIDES)):
            _ip("netns", "add", f"{name}-{place}")
            stack.callback(_ip, "netns", "delete", f"{name}-{place}")
            _ip("-n", f"{name}-{place}", "link", "set", "lo", "up")
        for side in SIDES:
            _wire(name, side)
        _forward(f"{name}-router")
        yield NatLab(name, stack.enter_context(ExitStack()))


def _wire(name: str, side: Side) -> None:
    """Lays the two cables of a side, and sets up its NAT."""
    inner, nat, router = f"{name}-{side}", f"{name}-nat-{side}", f"{name}-router"
    _ip("link", "add", "lan", "netns", inner, "type", "veth", "peer", "lan", "netns", nat)
    _ip("link", "add", "wan", "netns", nat, "type", "veth", "peer", side, "netns", router)
    for place, link, address in (
        (inner, "lan", INSIDE),
        (nat, "lan", GATEWAY),
        (nat, "wan", OUTSIDE[side]),
        (router, side, ROUTER[side]),
    ):
        _ip("-n", place, "address", "add", f"{address}/24", "dev", link)
        _ip("-n", place, "link", "set", link, "up")
    _ip("-n", inner, "route", "add", "default", "via", GATEWAY)
    _ip("-n", nat, "route", "add", "default", "via", ROUTER[side])
    _forward(nat)
    _nft(nat, NAT)


def _lossy(share: float) -> str:
    return f"add rule inet weather forward numgen random mod 1000 < {round(share * 1000)} drop\n"


def _forward(namespace: str) -> None:
    _run(["ip", "netns", "exec", namespace, "sh", "-c", "echo 1 >/proc/sys/net/ipv4/ip_forward"])


def _ip(*words: str) -> None:
    _run(["ip", *words])


def _nft(namespace: str, rules: str) -> None:
    _run(["ip", "netns", "exec", namespace, "nft", "-f", "-"], rules)


def _run(words: Sequence[str], text: str = "") -> None:
    subprocess.run(words, input=text, text=True, check=True, capture_output=True, timeout=10.0)


def _end(process: subprocess.Popen[str]) -> None:
    with process:  # closes its pipes
        process.terminate()
        try:
            process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
