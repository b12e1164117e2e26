"""The cell's machine and another one on the same network: two namespaces and a cable between them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final, Literal

from pcmrs_lab.campaign.namespaces import Namespaces, ip, namespaces
from pcmrs_lab.campaign.needs import ROOT, Need, program

Machine = Literal["cell", "other"]
ADDRESSES: Final[dict[Machine, str]] = {"cell": "192.168.1.1", "other": "192.168.1.2"}


def _is_permitted() -> bool:
    """Whether this process may make network namespaces; tried once."""
    try:
        with lan():
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


NEEDS: Final = (ROOT, program("ip"), Need("network namespaces", _is_permitted))


@contextmanager
def lan() -> Iterator[Namespaces[Machine]]:
    """Makes both machines, and ends all that was started on them.

    Raises:
        OSError: There is no `ip` here.
        subprocess.CalledProcessError: This machine does not permit them.
    """
    with namespaces(tuple(ADDRESSES)) as name:
        ip("link", "add", "lan", "netns", f"{name}-cell", "type", "veth", "peer", "lan", "netns", f"{name}-other")
        for machine, address in ADDRESSES.items():
            place = f"{name}-{machine}"
            ip("-n", place, "address", "add", f"{address}/24", "dev", "lan")
            ip("-n", place, "link", "set", "lan", "up")
            ip("-n", place, "route", "add", "default", "dev", "lan")  # for multicast, too
        with ExitStack() as processes:
            yield Namespaces(name, processes)
