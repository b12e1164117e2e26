"""Commands that serve virtual devices, and the list of their faults."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.printing import say, say_json
from pcmrs.cli.running import readable_errors, run
from pcmrs.cli.values import POSITIVE
from pcmrs_sim.cli.options import host_option, world_options

if TYPE_CHECKING:
    # For annotations only: `--help` must not load the simulation.
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
    help="Time after which the cabinet's application ends if no client connects, s.",
)


@click.command()
@host_option
@click.option("--port", type=PORT, default=30001, show_default=True, help="TCP port; 0 for any free one.")
@accept_option
@readable_errors
@world_options
def kst(host: str, port: int, accept_timeout: float, **world: Any) -> None:
    """Serve a KUKA cabinet with the KST 1.7 server, on a simulated iiwa.

    It has the traps of a real one: an unknown command is never answered, nor is anything after it; replies come split
    and merged; one client at a time; the application ends if nobody connects for 60 s (the fault 'restart_cabinet'
    restarts it). Lines on standard input are faults; pcmrs-sim faults lists them.

    Example: (sleep 5; echo e_stop on) | pcmrs-sim kst --duration 60
    """
    run(_serve({"kst": (host, port)}, accept_timeout, **world))


@click.command()
@host_option
@click.option("--port", type=PORT, default=8765, show_default=True, help="TCP port; 0 for any free one.")
@click.option("--pty", is_flag=True, help="Serve a pseudo-terminal, as a serial line, and print its path.")
@readable_errors
@world_options
def ndi(host: str, port: int, pty: bool, **world: Any) -> None:
    """Serve an NDI tracker that sees the simulated cell, with a person who holds the pointer.

    Lines on standard input are faults, or 'touch 0', 'touch_surface' or 'release' for the person.

    Example: pcmrs-sim ndi --pty --seed 3 --set sim.tracker.rate_hz=20
    """
    run(_serve({"ndi": None if pty else (host, port)}, 0.0, **world))


@click.command()
@host_option
@click.option("--kst-port", type=PORT, default=30001, show_default=True, help="TCP port of the cabinet; 0 for any.")
@click.option("--ndi-port", type=PORT, default=8765, show_default=True, help="TCP port of the tracker; 0 for any.")
@accept_option
@readable_errors
@world_options
def cell(host: str, kst_port: int, ndi_port: int, accept_timeout: float, **world: Any) -> None:
    """Serve cabinet and tracker of one simulated world, with a person who holds the pointer.

    Lines on standard input are faults, or 'touch 0', 'touch_surface' or 'release' for the person.

    Example: pcmrs-sim cell --phantom femur --schedule faults.txt
    """
    run(_serve({"kst": (host, kst_port), "ndi": (host, ndi_port)}, accept_timeout, **world))


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@readable_errors
def faults(as_json: bool) -> None:
    """List the faults that virtual devices can have.

    A line of a schedule or of standard input is a fault and its arguments: 'cut_robot on', 'offset_joint 3 0.05'.
    Without their last argument, faults that can be on or off are on.

    Example: pcmrs-sim faults --json
    """
    from pcmrs_sim.faults import FAULTS

    if as_json:
        rows = [
            {"name": fault.name, "row": fault.row, "arguments": fault.arguments, "help": fault.help}
            for fault in FAULTS.values()
        ]
        say_json(rows)
        return
    usages = {name: " ".join((name, *(f"<{each}>" for each in fault.arguments))) for name, fault in FAULTS.items()}
    width = max(map(len, usages.values()))
    for name, fault in FAULTS.items():
        say(f"{fault.row:<4} {usages[name]:<{width}}  {fault.help}")


async def _serve(
    addresses: dict[str, tuple[str, int] | None],
    accept_timeout: float,
    settings: dict[str, Any],
    schedule: Path | None,
    duration: float | None,
    as_json: bool,
) -> None:
    from pcmrs_sim.cli.running import serve

    def server(name: str) -> Any:
        return lambda cell: _open(name, addresses[name], accept_timeout, cell)

    await serve({name: server(name) for name in addresses}, settings, schedule, duration, as_json=as_json)


def _open(
    name: str, address: tuple[str, int] | None, accept_timeout: float, cell: CellSimulation
) -> AbstractAsyncContextManager[Address]:
    if name == "kst" and address is not None:
        from pcmrs_sim.kst.server import serve_kst

        return serve_kst(cell, *address, accept_timeout=accept_timeout)
    from pcmrs_sim.ndi.server import serve_ndi, serve_ndi_pty

    return serve_ndi_pty(cell) if address is None else serve_ndi(cell, *address)
