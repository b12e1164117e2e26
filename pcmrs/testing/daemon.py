"""A daemon as a child process: on free ports, in its own folder and cell."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import socket
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from pcmrs.bus.seal import read_key, write_key
from pcmrs.errors import DeviceError
from pcmrs.service import Ready
from pcmrs.service.processes.child import end_child
from pcmrs.threads import descendants
from pcmrs.workflows.settings import SIMULATED_FLANGE_FROM_TOOL_MARKER, SIMULATED_TOOL_MARKER_FROM_TOOL_TIP

__all__ = ["DaemonProcess", "free_port", "own_settings", "running_daemon"]

START_TIME = 300.0
"""Time within which the daemon must be ready, s: on a busy machine its imports alone take a minute."""

END_TIME = 15.0
"""Time within which the daemon must end, s."""

SIMULATED_TOOL = tuple(
    f"procedure.calibration.{name}.{part}={list(value)}"
    for name, pose in (
        ("flange_from_tool_marker", SIMULATED_FLANGE_FROM_TOOL_MARKER),
        ("tool_marker_from_tool_tip", SIMULATED_TOOL_MARKER_FROM_TOOL_TIP),
    )
    for part, value in (("position", pose.position), ("quat_wxyz", pose.quat_wxyz))
)
"""Poses of the simulated tool, for a daemon whose arm or tracker another process serves: it asks where its tool is."""

DEVICE_KEY = "device.key"
"""Name of the file of the key that daemon and device nodes share."""


@dataclass(frozen=True, slots=True)
class DaemonProcess:
    """A running daemon.

    Attributes:
        process: Child process: the daemon, or the program given before it.
        ready: Report of the daemon when it was ready.
    """

    process: asyncio.subprocess.Process
    ready: Ready


def own_settings(folder: Path, cell: str) -> list[str]:
    """Return the settings of a cell with its own folder, ports and device key; port 0 takes a free one.

    Args:
        folder: Folder of the cell.
        cell: Name of the cell.
    """
    device_key(folder)
    own = [f"cell.name={cell}", f"cell.folder={folder}", f"cell.endpoint=tcp/127.0.0.1:{free_port()}"]
    own.append(f"access.device_key={folder / DEVICE_KEY}")
    links = [f"gateway.{link}.port=0" for link in ("planner", "robot", "visualization", "mep")]
    # Addresses of virtual devices, for drivers that use them.
    virtual = [f"kst.port={free_port()}", f"ndi.device=127.0.0.1:{free_port()}"]
    return [*own, *links, "gateway.tcp_port=0", "recording.enabled=false", "console.enabled=false", *virtual]


def device_key(folder: Path) -> bytes:
    """Return the key that daemon and device nodes of a cell in `folder` share; it is made if there is none."""
    path = folder / DEVICE_KEY
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        write_key(path)
    return read_key(path)


def serve_command(overrides: Sequence[str]) -> list[str]:
    """Return the command line of a daemon with these settings, ``key=value`` each."""
    settings = [word for override in overrides for word in ("--set", override)]
    return [sys.executable, "-m", "pcmrs.cli", "serve", "--json", *settings]


@asynccontextmanager
async def running_daemon(
    overrides: Sequence[str], log: Path, *, prefix: Sequence[str] = (), environment: Mapping[str, str] | None = None
) -> AsyncIterator[DaemonProcess]:
    """Start a daemon, wait until it is ready, and end it and its nodes with the context, in any state.

    Args:
        overrides: Settings of the daemon, ``key=value`` each.
        log: File to which its standard error is appended.
        prefix: Words before its command line: a program that runs it.
        environment: Environment variables in addition to those of this process.

    Raises:
        DeviceError: The daemon did not start; the text has the end of its log.
    """
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            *prefix,
            *serve_command(overrides),
            "--lifeline",  # the daemon ends with this process, however that ends
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            env={**os.environ, **(environment or {})},
        )
    children: list[int] = []
    try:
        ready = await _ready(process, log)
        children = descendants(process.pid)
        yield DaemonProcess(process, ready)
    finally:
        await _end(process, children or descendants(process.pid))


def command_line(pid: int) -> list[str]:
    """Return the words of the command line of a process; a child of the fork server has them as its title."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode().split()


CHILDREN = {"node": "node", "world": "pcmrs_sim.process.world", "heart": "pcmrs.bus.heart"}
"""Permanent child processes of a daemon, each with a word of its command line."""


def processes_of(pid: int) -> list[tuple[str, int]]:
    """Return the names and ids of a daemon's process and of its `CHILDREN`."""
    found = [("daemon", pid)]
    for child in descendants(pid):
        words = command_line(child)
        found += [(name, child) for name, word in CHILDREN.items() if word in words]
    return found


def free_port() -> int:
    """Return a port that is free for TCP and UDP, below the range that Linux assigns itself."""
    while True:
        port = random.SystemRandom().randrange(20_000, 32_768)
        with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp, suppress(OSError):
            tcp.bind(("127.0.0.1", port))
            udp.bind(("127.0.0.1", port))
            return port


async def _end(process: asyncio.subprocess.Process, children: Sequence[int]) -> None:
    """End a daemon, which may be stopped or held by the program that runs it, and its remaining children."""
    for pid in (process.pid, *children):
        _send(pid, signal.SIGCONT)
    if process.returncode is None:
        process.terminate()
    await end_child(process, END_TIME)
    for pid in children:
        if _is_ours(pid):
            _send(pid, signal.SIGKILL)


def _is_ours(pid: int) -> bool:
    """Return True if a process still belongs to a daemon; its id may be in use by another one."""
    with suppress(OSError):
        return any("pcmrs" in word for word in command_line(pid))
    return False


def _send(pid: int, number: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, number)


async def _ready(process: asyncio.subprocess.Process, log: Path) -> Ready:
    line = b""
    if process.stdout is not None:
        try:
            async with asyncio.timeout(START_TIME):
                line = await process.stdout.readline()
        except TimeoutError:
            raise DeviceError(f"The daemon was not ready within {START_TIME:g} s: {log_tail(log)}") from None
    try:
        return msgspec.json.decode(line, type=Ready)
    except msgspec.MsgspecError:
        raise DeviceError(f"The daemon did not start: {log_tail(log)}") from None


def log_tail(log: Path, lines: int = 3) -> str:
    """Return the end of a log in one line.

    Args:
        log: Path of the log.
        lines: Number of lines.
    """
    return " ".join(log.read_text(errors="replace").splitlines()[-lines:])
