"""pcmrs console: the operating room's view, in a browser."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.cli.lifeline import NICENESS, inherited
from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors, run
from pcmrs.console.settings import TOKEN, UPLOADS, MotionConsent
from pcmrs.errors import ConfigurationError
from pcmrs.files import read_secret
from pcmrs.recording.settings import FOLDER

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the web server.
    from pcmrs.console.server import ListenAddress
    from pcmrs.settings import Settings


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address at which browsers reach it.")
@click.option(
    "--port", default=8080, type=click.IntRange(0, 65535), show_default=True, help="Port; 0 for any free one."
)
@click.option(
    "--name",
    "names",
    multiple=True,
    metavar="HOST:PORT",
    help="Another name for it, as behind a proxy; may be repeated.",
)
@click.option(
    "--token-file",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    metavar="FILE",
    help="The token to use, in a file that only you may read; a new one at every start without it.",
)
@click.option(
    "--recordings",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="FOLDER",
    help="Folder whose recordings can be replayed, in addition to the cell's folder.",
)
@click.option("--language", type=click.Choice(["en", "de"]), default="en", show_default=True)
@click.option(
    "--consent",
    type=click.Choice(["hold", "confirm"]),
    default="hold",
    show_default=True,
    help="How you show that a motion is meant: press and hold its button, or confirm it.",
)
@click.option("--lifeline", is_flag=True, hidden=True, help="Read the configuration from standard input; end with it.")
@click.option("--listening", type=int, hidden=True, help="File descriptor of a socket that listens at the port.")
@json_option
@address_options
@readable_errors
def console(
    host: str,
    port: int,
    names: tuple[str, ...],
    token_file: Path | None,
    recordings: Path | None,
    language: str,
    consent: MotionConsent,
    lifeline: bool,
    listening: int | None,
    as_json: bool,
    address: CellAddress,
) -> None:
    """Serve the page that shows a cell: workflow, scene, planning, signals and session.

    Prints the address with its token: anyone who has it may do there what your role may do. It is a client of the bus
    and may end at any time; the cell keeps running.

    Exit status: 0 ended, 3 the port is taken, 4 the identity cannot be used.

    Example: pcmrs console --endpoint tls/router.example.org:7449 --identity anna
    """
    try:
        from pcmrs.console.server import ListenAddress  # loads the web server
    except ModuleNotFoundError as error:
        text = f"The page is served by the package {error.name}, which is missing: "
        text += "install the extra console (docs/supply.md)."
        raise ConfigurationError(text, package=error.name) from None

    uploads = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "pcmrs" / UPLOADS
    if lifeline:
        os.nice(NICENESS)
        settings = inherited().settings
        port, language, token_file = settings.console.port, settings.console.language, settings.cell.path() / TOKEN
        consent = settings.console.consent
        recordings, address = settings.cell.path() / FOLDER, _address(settings)
        uploads = settings.cell.path() / UPLOADS
    address.credentials()  # an unusable identity is reported before anything is served
    token = secrets.token_urlsafe(24) if token_file is None else read_secret(token_file).decode().strip()

    def ready(url: str) -> None:
        if as_json:
            say_json({"url": url})
        else:
            say(f"open {url}")
        sys.stdout.flush()

    place = ListenAddress(host, port, names, listening)
    run(_serve(address, place, token, language, ready, uploads, recordings, consent, lifeline=lifeline))


def _address(settings: Settings) -> CellAddress:
    """Return the address of the daemon that starts this console, on its own machine."""
    cell, bus = settings.cell, settings.bus("client")
    return CellAddress(cell.endpoint, cell.site, cell.name, Path(settings.access.identity) if bus.credentials else None)


async def _serve(
    address: CellAddress,
    place: ListenAddress,
    token: str,
    language: str,
    ready: Callable[[str], None],
    uploads: Path,
    recordings: Path | None,
    consent: MotionConsent,
    *,
    lifeline: bool,
) -> None:
    from pcmrs.console.server import serve_console
    from pcmrs.node import when_input_ends

    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    if lifeline:
        when_input_ends(ended.set)
    await serve_console(address.connect, place, token, language, ready, ended, uploads, recordings, consent)
