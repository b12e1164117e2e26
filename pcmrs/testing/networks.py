"""Machines on one network, as network namespaces of this machine, and the programs that run on them.

`lan` makes the cell's machine and another one with a cable between them.
"""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final, Generic, Literal, TypeVar

from pcmrs.testing.needs import ROOT, Need, program

__all__ = ["ADDRESSES", "NEEDS", "Machine", "Namespaces", "ip", "lan", "namespaces", "run_quietly"]

PlaceName = TypeVar("PlaceName", bound=str)

END_TIME: Final = 5.0


class Namespaces(Generic[PlaceName]):
    """Network namespaces by the names of their places.

    Args:
        name: Prefix of their names.
        processes: Stack that ends the processes that were started in them.

    Attributes:
        name: Prefix of their names.
    """

    def __init__(self, name: str, processes: ExitStack) -> None:
        self.name = name
        self._processes = processes

    def prefix(self, place: PlaceName) -> list[str]:
        """Return the words before a command line that run it at `place`."""
        return ["ip", "netns", "exec", f"{self.name}-{place}"]

    def run(self, place: PlaceName, *command: str, timeout: float = 10.0) -> subprocess.CompletedProcess[str]:
        """Run a command to its end, with any exit status.

        Args:
            place: Place at which it runs.
            command: Words of the command line.
            timeout: Time limit, s.

        Returns:
            Completed process with its output.

        Raises:
            subprocess.TimeoutExpired: The command has not ended within `timeout` and was killed.
        """
        words = [*self.prefix(place), *command]
        return subprocess.run(words, capture_output=True, text=True, check=False, timeout=timeout)

    def start(self, place: PlaceName, *command: str, **streams: Any) -> subprocess.Popen[str]:
        """Start a process that ends with the namespaces at the latest.

        Args:
            place: Place at which it runs.
            command: Words of the command line.
            streams: Arguments of `subprocess.Popen` for its standard streams.
        """
        process = subprocess.Popen([*self.prefix(place), *command], text=True, **streams)
        self._processes.callback(_end, process)
        return process


@contextmanager
def namespaces(places: Sequence[str]) -> Iterator[str]:
    """Make a namespace with loopback for each place, and yield the prefix of their names.

    Raises:
        OSError: The program `ip` is missing.
        subprocess.CalledProcessError: This machine does not permit namespaces.
    """
    name = f"pcmrs-{uuid.uuid4().hex[:8]}"
    with ExitStack() as stack:
        for place in places:
            ip("netns", "add", f"{name}-{place}")
            stack.callback(ip, "netns", "delete", f"{name}-{place}")
            ip("-n", f"{name}-{place}", "link", "set", "lo", "up")
        yield name


def ip(*words: str) -> None:
    """Run `ip`; raise errors as `namespaces` does."""
    run_quietly(["ip", *words])


def run_quietly(words: Sequence[str], text: str = "") -> None:
    """Run a program with a text as its input.

    Args:
        words: Words of the command line.
        text: Standard input.

    Raises:
        OSError: The program is missing.
        subprocess.CalledProcessError: The program has failed.
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
"""Machine of `lan`: that of the cell, and another one."""
ADDRESSES: Final[dict[Machine, str]] = {"cell": "192.168.1.1", "other": "192.168.1.2"}
"""Address of each machine of `lan`."""


def _is_permitted() -> bool:
    """Return whether this process may make network namespaces; it tries one."""
    try:
        with lan():
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


NEEDS: Final = (ROOT, program("ip"), Need("network namespaces", _is_permitted))
"""Requirements of `lan` on this machine."""


@contextmanager
def lan() -> Iterator[Namespaces[Machine]]:
    """Make both machines for the length of the context, and end all processes that were started on them.

    Raises:
        OSError: The program `ip` is missing.
        subprocess.CalledProcessError: This machine does not permit namespaces.
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
