"""The list of faults."""

from __future__ import annotations

import click
import msgspec

from pcmrs.cli.running import readable_errors


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@readable_errors
def faults(as_json: bool) -> None:
    """List the faults that can be brought about in virtual devices.

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
        click.echo(msgspec.json.encode(rows).decode())
        return
    usages = {name: " ".join((name, *(f"<{each}>" for each in fault.arguments))) for name, fault in FAULTS.items()}
    width = max(map(len, usages.values()))
    for name, fault in FAULTS.items():
        click.echo(f"{fault.row:<4} {usages[name]:<{width}}  {fault.help}")
