"""`pcmrs-serve`: the daemon of one cell; and the device nodes that it starts."""

from __future__ import annotations

import asyncio
import signal
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.lifeline import inherited, inherited_table
from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.options import config_options
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.running import readable_errors, run
from pcmrs.descriptors import reserve
from pcmrs.errors import ConfigurationError
from pcmrs.files import keep_private, read_secret
from pcmrs.lean_structlog import structlog

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the robot's kinematics.
    from pcmrs.service import Daemon, Ready

log = structlog.get_logger(__name__)

CHILD_MODULES = ("pcmrs.bus.heart", "pcmrs.node", "pcmrs.workflows.planning_process", "pcmrs.recording.writer")
"""Modules of the daemon's child processes, which its fork server imports."""

TCP_LINKS = ("tcp", "openigtlink")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@config_options
@click.option("--json", "as_json", is_flag=True, help="Print its addresses as one line of JSON.")
@click.option("--verbose", is_flag=True, help="Log every detail.")
@click.option("--lifeline", is_flag=True, hidden=True, help="Also end when standard input ends.")
@readable_errors
def serve(file: Path | None, overrides: tuple[str, ...], as_json: bool, verbose: bool, lifeline: bool) -> None:
    """Run the daemon of one cell: by default robotic TMS on the simulated cell.

    Ends on SIGINT and SIGTERM; a running motion is held first. Exit status: 0 ended as requested,
    2 failed, 3 the bus cannot be opened (another daemon listens there), 4 bad configuration.
    """
    from pcmrs.settings import read_settings

    reserve()
    keep_private()  # the daemon's children inherit this
    log_to_stderr(verbose=verbose)
    settings = read_settings(file, overrides)
    # After the settings, which name the extra of a missing driver; before the fork, so that children share them.
    from pcmrs.processes.fork_server import ForkServer
    from pcmrs.service import Daemon

    with closing(ForkServer.fork(CHILD_MODULES)) as start_process:
        run(_serve(Daemon(settings, start_process), as_json=as_json, lifeline=lifeline))


@click.command(hidden=True)
@click.argument("driver")
@click.argument("devices", nargs=-1, required=True)
@config_options
@readable_errors
def node(driver: str, devices: tuple[str, ...], file: Path | None, overrides: tuple[str, ...]) -> None:
    """Serve DEVICES with DRIVER for a daemon.

    Without --config and --set the configuration is read from standard input, as one line of JSON, and
    the node ends when standard input ends. On another machine it needs `access.device_key`.
    """
    from pcmrs.config import as_table
    from pcmrs.devices.opening import open_driver

    lifeline = file is None and not overrides
    if lifeline:
        line = sys.stdin.buffer.readline()
        # Before anything else: the process of a simulated cell is a fork of this one, as long as it has one thread.
        opening = open_driver(driver, devices, inherited_table(line))
        log_to_stderr()
        given = inherited(line)
        settings, key = given.settings, _checked(given.device_key)
    else:
        from pcmrs.settings import read_settings

        log_to_stderr()
        settings = read_settings(file, overrides)
        key = _checked(settings.access.read_device_key())
        opening = open_driver(driver, devices, as_table(settings))
    from pcmrs.node import serve_devices

    run(serve_devices(settings, driver, devices, opening, key, lifeline=lifeline))


def _checked(device_key: bytes | None) -> bytes:
    if not device_key:
        text = "A device node needs the key that it shares with its daemon: set access.device_key on both sides to a "
        text += "copy of the file that `pcmrs pki device-key FILE` makes."
        raise ConfigurationError(text)
    return device_key


async def _serve(daemon: Daemon, *, as_json: bool, lifeline: bool) -> None:
    from pcmrs.node import when_input_ends

    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    if lifeline:
        when_input_ends(ended.set)
    async with daemon.running() as ready:
        if as_json:
            say_json(ready)
        else:
            say_lines(_lines(ready))
        sys.stdout.flush()
        await ended.wait()
        log.info("ending: motion is held first")


def _opened(ready: Ready) -> str:
    """Return the link to the page; with its token on a terminal only, since other output is stored in logs."""
    from pcmrs.console.settings import TOKEN

    token = Path(ready.folder) / TOKEN
    if sys.stdout.isatty():
        return f"{ready.console}/?token={read_secret(token).decode()}"
    return f"{ready.console} (token: {token})"


def _lines(ready: Ready) -> list[str]:
    faster = f", {ready.rate:g} times as fast as real time" if ready.rate != 1.0 else ""
    lines = [
        f"pcmrs-serve: {ready.workflow}{faster}. Research software, not a medical device.",
        f"  bus            {ready.endpoint}, keys {ready.prefix}/** (list them: pcmrs keys)",
    ]
    lines += [f"  from outside   {endpoint}" for endpoint in ready.listen]
    lines += [f"  router         {endpoint}" for endpoint in ready.routers]
    for name, (host, port) in ready.links.items():
        lines.append(f"  {name:<14} {'tcp' if name in TCP_LINKS else 'udp'} {host}:{port}")
    lines.append(f"  journal        {ready.journal}")
    if ready.metrics:
        lines.append(f"  metrics        {ready.metrics}")
    if ready.console:
        lines.append(f"  console        {_opened(ready)}")
    return [*lines, "ready"]
