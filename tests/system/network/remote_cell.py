"""A cell and a console that meet at a router: behind two NATs where namespaces are permitted, on loopback otherwise."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from pcmrs.clock import SystemClock
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs.testing.natlab import ROUTER, NatLab, Place, Side, nat_lab

PCMRS = [sys.executable, "-m", "pcmrs.cli"]
SITE, CELL = "lab", "far1"
PATIENCE = 60.0

RATMS: list[tuple[str, Mapping[str, Any]]] = [
    ("registration.plan_landmarks", landmarks()),
    ("digitization.digitize_all", {}),
    ("registration.register", {}),
    ("toolplan.plan", tool_pose()),
    ("robot.connect", {}),
    ("placement.approach", {}),
    ("placement.confirm", {}),
    ("placement.back_off", {}),
    ("placement.home", {}),
]
"""A whole placement, from the plan to the arm at rest."""

LONG_WAY = """
import asyncio, sys
from pcmrs.testing.proxy import tcp_proxy
from pcmrs.testing.impairment import NetworkImpairment

async def run(host, port, delay, jitter):
    impairment = NetworkImpairment(delay=float(delay), jitter=float(jitter))
    async with tcp_proxy((host, int(port)), impairment) as (_, proxied):
        print(proxied, flush=True)
        await asyncio.Event().wait()

asyncio.run(run(*sys.argv[1:]))
"""


class Network(Protocol):
    """Where the processes run, and how they dial the router."""

    def prefix(self, place: Place) -> list[str]: ...

    def endpoint(self, side: Side) -> str: ...

    @property
    def listen(self) -> str: ...


class Namespaces:
    """Two NATs, and a router between them."""

    def __init__(self, lab: NatLab) -> None:
        self.lab = lab
        self.listen = "tls/0.0.0.0:7449"

    def prefix(self, place: Place) -> list[str]:
        return self.lab.prefix(place)

    def endpoint(self, side: Side) -> str:
        return f"tls/{ROUTER[side]}:7449"


class Loopback:
    """One machine."""

    def __init__(self) -> None:
        self.listen = f"tls/127.0.0.1:{free_port()}"

    def prefix(self, _: Place) -> list[str]:
        return []

    def endpoint(self, _: Side) -> str:
        return self.listen


@dataclass
class RemoteCell:
    """A running cell, its router, and a console elsewhere.

    Attributes:
        network: Where they run.
        folder: Of everything.
        router: The router's process.
        console: Endpoint and identity of the console, as options of every command.
        links: Host and port of each of the gateway's links.
    """

    network: Network
    folder: Path
    router: subprocess.Popen[str]
    console: list[str]
    links: dict[str, tuple[str, int]] = field(default_factory=dict)

    def pcmrs(self, *words: str, timeout: float = PATIENCE) -> subprocess.CompletedProcess[str]:
        """A command of the console, run to its end."""
        command = [*self.network.prefix("remote"), *PCMRS, *words, *self.console]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)

    def begin(self, *words: str) -> subprocess.Popen[str]:
        """A command of the console that goes on."""
        command = [*self.network.prefix("remote"), *PCMRS, *words, *self.console]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def guide(self, script: str) -> subprocess.Popen[str]:
        """A teleoperator whose hands follow a script, and who tells statuses."""
        file = self.folder / "script.txt"
        file.write_text(script)
        return self.begin("teleop", "--device", "script", "--script", str(file), "--json")

    def call(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """The verdict on an operation that the console asks for."""
        done = self.pcmrs("call", name, json.dumps(arguments), "--json")
        assert done.stdout, done.stderr
        verdict: dict[str, Any] = json.loads(done.stdout)
        return verdict

    def accept(self, name: str, arguments: Mapping[str, Any] | None = None) -> None:
        verdict = self.call(name, arguments or {})
        assert verdict["decision"] == "accepted", verdict

    def on_site(self) -> dict[str, Any]:
        """The state, asked on the cell's own machine."""
        return self._on_site("state")

    def call_on_site(self, name: str) -> str:
        """Decision on an operation that somebody on site asks for."""
        return str(self._on_site("call", name)["decision"])

    def until(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The first state on site of which the condition holds."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            shown = self.on_site()
            if condition(shown):
                return shown
        raise AssertionError(f"It did not come about: {shown}")

    def rows(self, operation: str) -> list[dict[str, Any]]:
        """Rows of the journal about an operation, read from the file."""
        done = subprocess.run(
            [*PCMRS, "journal", "show", str(self.folder / "cell" / "ratms.sqlite"), "--json"],
            capture_output=True, text=True, check=True, timeout=PATIENCE,
        )  # fmt: skip
        rows = [json.loads(line)["row"] for line in done.stdout.splitlines()]
        return [row for row in rows if row.get("operation") == operation]

    def restart_router(self) -> None:
        """Kills the router, starts it again, and returns when the daemon has connected to it."""
        self.router.kill()
        _end(self.router)
        self.router = start_router(self.network, self.folder)
        end = time.monotonic() + PATIENCE
        while (asked := self.pcmrs("state")).returncode:
            assert time.monotonic() < end, asked.stderr

    def _on_site(self, *words: str) -> dict[str, Any]:
        """What a command says that is given on the cell's own machine."""
        endpoint = f"tcp/127.0.0.1:{(self.folder / 'port').read_text()}"
        address = ["--endpoint", endpoint, "--site", SITE, "--cell", CELL]
        command = [*self.network.prefix("cell"), *PCMRS, *words, "--json", *address]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
        assert done.stdout, done.stderr
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer


def start_router(network: Network, folder: Path) -> subprocess.Popen[str]:
    """A router that listens."""
    words = ["router", "--identity", "gate", "--register", "pki/register.json", "--listen", network.listen]
    router = subprocess.Popen(
        [*network.prefix("router"), *PCMRS, *words], cwd=folder, stdout=subprocess.PIPE, text=True
    )
    assert router.stdout is not None
    for line in router.stdout:
        if line.strip() == "ready":
            return router
    _end(router)
    raise AssertionError("The router has not started.")


@contextmanager
def long_way(network: Network, delay: float, jitter: float) -> Iterator[str]:
    """A proxy on the remote side that delays everything each way, s; yields where the console dials then."""
    host, _, port = network.endpoint("remote").removeprefix("tls/").rpartition(":")
    command = [*network.prefix("remote"), sys.executable, "-c", LONG_WAY, host, port, str(delay), str(jitter)]
    proxy = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert proxy.stdout is not None
        yield f"tls/127.0.0.1:{proxy.stdout.readline().strip()}"
    finally:
        _end(proxy)


@contextmanager
def remote_cell(network: Network, folder: Path, *settings: str, dialled: str = "") -> Iterator[RemoteCell]:
    """Router, cell and the identities of a console, ended with the block; `dialled` is a long way to the router."""
    now = SystemClock().wall()
    authority = Authority.init(folder / "pki", SITE, now)
    authority.issue("router", "gate", now, hosts=(*ROUTER.values(), "127.0.0.1"), cells=EVERY_CELL, into=folder)
    authority.issue("daemon", "daemon1", now, cells=(f"{SITE}/{CELL}",), into=folder)
    authority.issue("teleoperator", "tom", now, cells=(f"{SITE}/{CELL}",), via=("gate",), into=folder)
    authority.issue("viewer", "eve", now, cells=(f"{SITE}/{CELL}",), via=("gate",), into=folder)
    port = free_port()
    (folder / "port").write_text(str(port))
    overrides = (
        f"cell.site={SITE}", f"cell.name={CELL}", f"cell.folder={folder / 'cell'}",
        f"cell.endpoint=tcp/127.0.0.1:{port}",
        f"access.identity={folder / 'daemon1'}", f"access.register={authority.folder / 'register.json'}",
        f'access.routers=["{network.endpoint("cell")}"]', "access.lease_s=3",
        "recording.enabled=false", "console.enabled=false",
        *(f"gateway.{link}.port=0" for link in ("planner", "robot", "visualization", "mep")), "gateway.tcp_port=0",
        *settings,
    )  # fmt: skip
    words = [word for each in overrides for word in ("--set", each)]
    with ExitStack() as stack:
        console = ["--endpoint", dialled or network.endpoint("remote"), "--identity", str(folder / "tom")]
        cell = RemoteCell(network, folder, start_router(network, folder), [*console, "--site", SITE, "--cell", CELL])
        stack.callback(lambda: _end(cell.router))
        log = stack.enter_context((folder / "daemon.log").open("w"))
        daemon = subprocess.Popen(
            [*network.prefix("cell"), *PCMRS, "serve", "--verbose", "--json", *words],
            stdout=subprocess.PIPE, stderr=log, text=True,
        )  # fmt: skip
        stack.callback(_end, daemon)
        assert daemon.stdout is not None
        ready = daemon.stdout.readline()
        assert ready, (folder / "daemon.log").read_text()
        cell.links = json.loads(ready)["links"]
        yield cell


@contextmanager
def behind_nats() -> Iterator[Namespaces]:
    """The network of two NATs."""
    with nat_lab() as lab:
        yield Namespaces(lab)


def _end(process: subprocess.Popen[str]) -> None:
    with process:
        process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
