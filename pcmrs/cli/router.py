"""`pcmrs-router`: the router that cells and people connect to, so that neither needs an open port."""

from __future__ import annotations

import asyncio
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from pcmrs.cli.log import log_to_stderr
from pcmrs.cli.options import identity_option, json_option
from pcmrs.cli.printing import say_json, say_lines
from pcmrs.cli.running import readable_errors, run

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the bus.
    from pcmrs.bus import BusSettings


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@identity_option
@click.option(
    "--register",
    type=click.Path(path_type=Path, dir_okay=False),
    envvar="PCMRS_REGISTER",
    metavar="FILE",
    required=True,
    help="Copy of the authority's register.json, with all identities and their rights.",
)
@click.option(
    "--listen",
    multiple=True,
    envvar="PCMRS_LISTEN",
    default=("tls/0.0.0.0:7449",),
    show_default="tls/0.0.0.0:7449",
    metavar="ENDPOINT",
    help="Endpoint to listen on; may be repeated.",
)
@click.option("--print-config", is_flag=True, help="Print the configuration for zenohd, and end.")
@json_option
@readable_errors
def router(identity: Path | None, register: Path, listen: tuple[str, ...], print_config: bool, as_json: bool) -> None:
    """Forward the messages of cells and people, as far as the register allows them.

    A revoked identity is refused from the next start on, with the present register. Ends on SIGINT and SIGTERM. Exit
    status: 0 ended as requested, 3 the endpoint cannot be opened, 4 bad configuration.

    Example: pcmrs-router --identity gate --register register.json
    """
    from pcmrs.router import router_settings

    if identity is None:
        raise click.UsageError("--identity is missing: pcmrs pki issue router NAME --host HOST")
    settings = router_settings(identity, register, listen)
    if print_config:
        say_lines(_zenohd(settings).split("\n"))
        return
    log_to_stderr()
    run(_route(settings, as_json=as_json))


async def _route(settings: BusSettings, *, as_json: bool) -> None:
    from pcmrs.router import routing
    from pcmrs.service.health.service_manager import ServiceManager

    loop, ended, manager = asyncio.get_running_loop(), asyncio.Event(), ServiceManager()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    async with routing(settings):
        report = {"name": settings.user, "listen": settings.listen, "members": len(settings.members)}
        if as_json:
            say_json(report)
        else:
            say_lines(_lines(settings))
        sys.stdout.flush()
        manager.notify("READY=1")
        await ended.wait()
        manager.notify("STOPPING=1")


def _lines(settings: BusSettings) -> list[str]:
    first = f"pcmrs-router {settings.user}: {len(settings.members)} in the register"
    return [first, *(f"  listens at {endpoint}" for endpoint in settings.listen), "ready"]


def _zenohd(settings: BusSettings) -> str:
    """Return the settings as one JSON document for Zenoh, with nested tables for the slashes of its keys."""
    whole: dict[str, object] = {}
    for path, value in settings.zenoh_config().items():
        *folders, name = path.split("/")
        place = whole
        for folder in folders:
            place = place.setdefault(folder, {})  # type: ignore[assignment]
        place[name] = value
    return msgspec.json.format(msgspec.json.encode(whole), indent=2).decode()
