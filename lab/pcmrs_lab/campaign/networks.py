"""The cell's machine and another one on the same network: two namespaces and a cable between them.

Machines of a network that is made of namespaces of this machine, and the programs that run on them.
"""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final, Generic, Literal, TypeVar

from pcmrs_lab.campaign.needs import ROOT, Need, program

PlaceName = TypeVar("PlaceName", bound=str)

END_TIME: Final = 5.0


class Namespaces(Generic[PlaceName]):
    """Namespaces by the names of their places.

    Args:
        name: Begins the names of all of them.
        processes: Ends what was started in them.

    Attributes:
        name: As given.
    """

    def __init__(self, name: str, processes: ExitStack) -> None:
        self.name = name
        self._processes = processes

    def prefix(self, place: PlaceName) -> list[str]:
        """The words before a command line that has it run at `place`."""
        return ["ip", "netns", "exec", f"{self.name}-{place}"]

    def run(self, place: PlaceName, *command: str, timeout: float = 10.0) -> subprocess.CompletedProcess[str]:
        """Runs a command to its end, whatever status that has.

        Raises:
            subprocess.TimeoutExpired: It has not ended after `timeout`, s, and was killed.
        """
        words = [*self.prefix(place), *command]
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout)

    def start(self, place: PlaceName, *command: str, **streams: Any) -> subprocess.Popen[str]:
        """Starts a process that ends with the namespaces at the latest."""
        process = subprocess.Popen([*self.prefix(place), *command], text=True, **streams)
        self._processes.callback(_end, process)
        return process


@contextmanager
def namespaces(places: Sequence[str]) -> Iterator[str]:
    """Makes a namespace for each place, with its loopback; yields what their names begin with.

    Raises:
        OSError: There is no `ip` here.
        subprocess.CalledProcessError: This machine does not permit them.
    """
    name = f"pcmrs-{uuid.uuid4().hex[:8]}"
    with ExitStack() as stack:
        for place in places:
            ip("netns", "add", f"{name}-{place}")
            stack.callback(ip, "netns", "delete", f"{name}-{place}")
            ip("-n", f"{name}-{place}", "link", "set", "lo", "up")
        yield name


def ip(*words: str) -> None:
    """Runs `ip`. Raises as `namespaces`."""
    run_quietly(["ip", *words])


def run_quietly(words: Sequence[str], text: str = "") -> None:
    """Runs a program with a text as its input.

    Raises:
        OSError: It is not here.
        subprocess.CalledProcessError: It has failed.
    """
    subprocess.run(words, input=text, text=True, check=True, capture_output=True, timeout=10.0)


def _end(process: subprocess.Popen[str]) -> None:
    with process:  # closes its pipes
        process.terminate()
        try:
            process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            process.kill()


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
