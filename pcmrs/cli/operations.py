"""`pcmrs operations`: what can be asked for, with which arguments, and what is allowed now."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say_json
from pcmrs.cli.running import readable_errors, run

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the bus.
    from pcmrs.messages import Snapshot
    from pcmrs.messages.setup import ArgumentShown, Setup


@click.command()
@click.argument("branch", default="")
@json_option
@address_options
@readable_errors
def operations(branch: str, as_json: bool, address: CellAddress) -> None:
    """List the operations with their arguments, and whether they are allowed now.

    With BRANCH only those of one branch. What only devices and timers report is not listed. Plans and other arguments
    that are no single values are shown as JSON. The daemon decides again when an operation is requested.

    Example: pcmrs operations placement
    """
    found = list(_rows(*run(_asked(address)), branch))
    if not found:
        raise click.UsageError(f"There is no branch '{branch}': pcmrs state lists the branches.")
    if as_json:
        say_json(found)
        return
    from rich.table import Column, Table

    from pcmrs.cli.tables import print_table, styled

    table = Table(Column("operation", no_wrap=True), "arguments", "allowed now")
    for row in found:
        arguments = styled(*map(_in_words, row["arguments"]))
        table.add_row(row["operation"], arguments, "yes" if row["allowed"] else row["why_not"])
    print_table(table)


async def _asked(address: CellAddress) -> tuple[Snapshot, Setup]:
    async with address.connect() as client:
        return client.greeting, await client.setup()


def _rows(shown: Snapshot, setup: Setup, only: str) -> Iterator[dict[str, Any]]:
    from pcmrs.dispatcher.objections import Objections
    from pcmrs.fsm import parse_blueprint

    blueprint = parse_blueprint(setup.blueprint.encode())
    objections = Objections(blueprint, shown, setup)
    for name, branch in blueprint.branches.items():
        for operation, spec in branch.operations.items():
            if spec.iio or spec.event or only not in ("", name):
                continue
            objection = objections.to(name, operation, spec)
            why_not = objection if isinstance(objection, str) else objection.text
            arguments: Sequence[ArgumentShown] = setup.arguments.get(spec.payload, [])
            yield {
                "operation": f"{name}.{operation}",
                "title": spec.title,
                "moves": spec.moves,
                "affects_patient": spec.affects_patient,
                "arguments": arguments,
                "allowed": not why_not,
                "why_not": why_not,
            }


def _in_words(argument: ArgumentShown) -> str:
    """Return name, kind, unit, limits and default of an argument."""
    kind: str = argument.kind if argument.kind != "other" else "JSON"
    if argument.kind == "numbers":
        kind = f"{argument.count} numbers"
    elif argument.kind == "choice":
        kind = " or ".join(argument.choices)
    limits = [
        f"{word} {value:g}"
        for word, value in (
            ("from", argument.least), ("to", argument.most), ("above", argument.above), ("below", argument.below),
        )
        if value is not None
    ]  # fmt: skip
    unit = f" {argument.unit}" if argument.unit else ""
    default = "" if argument.required else " (optional)"
    return f"{argument.name}: {' '.join([kind + unit, *limits])}{default}"
