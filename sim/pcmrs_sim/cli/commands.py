"""Commands that serve virtual devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.values import POSITIVE
from pcmrs_sim.cli.options import host_option, world_options

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the simulation.
    from contextlib import AbstractAsyncContextManager

    from pcmrs_sim.cell import CellSimulation
    from pcmrs_sim.cli.running import Address

PORT = click.IntRange(0, 65535)
accept_option = click.option(
    "--accept-timeout",
    type=POSITIVE,
    default=60.0,
    show_default=True,
    metavar="S",
    help="The cabinet's application ends when no client has come for so long.",
)


@click.command()
@host_option
@click.option("--port", type=PORT, default=30001, show_default=True, help="0 for any that is free.")
@accept_option
@readable_errors
@world_options
def kst(host: str, port: int, accept_timeout: float, **given: Any) -> None:
    """Serve a KUKA cabinet with the KST 1.7 server, on a simulated iiwa.

    It has the traps of a real one: an unknown command is never answered, nor is anything after it; replies come split
    and merged; one client at a time; the application ends when nobody connects for 60 s ('restart_cabinet' starts it
    again). Lines on standard input are faults; list them with pcmrs-sim faults.

    Example: (sleep 5; echo e_stop on) | pcmrs-sim kst --duration 60
    """
    run(_serve({"kst": (host, port)}, accept_timeout, **given))


@click.command()
@host_option
@click.option("--port", type=PORT, default=8765, show_default=True, help="0 for any that is free.")
@click.option("--pty", is_flag=True, help="On a pseudo-terminal, as on a serial line; its path is printed.")
@readable_errors
@world_options
def ndi(host: str, port: int, pty: bool, **given: Any) -> None:
    """Serve an NDI tracker that sees the simulated cell, with a person who has the pointer.

    On standard input: faults, and 'touch 0', 'touch_surface', 'release' for the person.

    Example: pcmrs-sim ndi --pty --seed 3 --set sim.tracker.rate_hz=20
    """
    run(_serve({"ndi": None if pty else (host, port)}, 0.0, **given))


@click.command()
@host_option
@click.option("--kst-port", type=PORT, default=30001, show_default=True, help="Of the cabinet; 0 for any.")
@click.option("--ndi-port", type=PORT, default=8765, show_default=True, help="Of the tracker; 0 for any.")
@accept_option
@readable_errors
@world_options
def cell(host: str, kst_port: int, ndi_port: int, accept_timeout: float, **given: Any) -> None:
    """Serve cabinet and tracker of one simulated world, with a person who has the pointer.

    On standard input: faults, and 'touch 0', 'touch_surface', 'release' for the person.

    Example: pcmrs-sim cell --phantom femur --schedule faults.txt
    """
    run(_serve({"kst": (host, kst_port), "ndi": (host, ndi_port)}, accept_timeout, **given))


async def _serve(
    places: dict[str, tuple[str, int] | None],
    accept_timeout: float,
    settings: dict[str, Any],
    schedule: Path | None,
    duration: float | None,
    as_json: bool,
) -> None:
    from pcmrs_sim.cli.running import serve

    def server(name: str) -> Any:
        return lambda cell: _open(name, places[name], accept_timeout, cell)

    await serve({name: server(name) for name in places}, settings, schedule, duration, as_json=as_json)


def _open(
    name: str, place: tuple[str, int] | None, accept_timeout: float, cell: CellSimulation
) -> AbstractAsyncContextManager[Address]:
    if name == "kst" and place is not None:
        from pcmrs_sim.kst.server import serve_kst

        return serve_kst(cell, *place, accept_timeout=accept_timeout)
    from pcmrs_sim.ndi.server import serve_ndi, serve_ndi_pty

    return serve_ndi_pty(cell) if place is None else serve_ndi(cell, *place)
