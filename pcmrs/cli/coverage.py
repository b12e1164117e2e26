"""`pcmrs coverage`: touched points of the surface by region, and where more of them would help most."""

from __future__ import annotations

import sys
from typing import Any

import click
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table

from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.running import EXIT_REJECTED, readable_errors, run
from pcmrs.cli.tables import print_report
from pcmrs.messages import DryRunResult

REFINE = "registration.refine"


@click.command()
@json_option
@address_options
@readable_errors
def coverage(as_json: bool, address: CellAddress) -> None:
    """Print how many points of the surface were touched where, and where more of them would lower the TRE most.

    It asks for a dry run of registration.refine, which changes nothing.

    Exit status: 0 printed, 1 the landmarks cannot be registered yet, 3 no daemon.
    """
    answer = run(_ask(address))
    print_report(answer, coverage_table(answer), as_json=as_json)
    if coverage_of(answer) is None:
        sys.exit(EXIT_REJECTED)


async def _ask(address: CellAddress) -> DryRunResult:
    async with address.connect() as client:
        return await client.check(REFINE, {})


def coverage_of(answer: DryRunResult) -> dict[str, Any] | None:
    """Return the coverage in the answer to a dry run of a refinement, lengths in m; None if it has none."""
    found: dict[str, Any] | None = answer.result.get("coverage")
    if found is None and answer.reason is not None:
        found = answer.reason.fields.get("coverage")
    return found


def coverage_table(answer: DryRunResult) -> RenderableType:
    """Return the verdict on a refinement now, the offsets, and the coverage by region."""
    found = coverage_of(answer)
    shown: list[RenderableType] = []
    if answer.reason is not None:
        shown.append(f"{REFINE} would be refused: {answer.reason.code}: {answer.reason.text}")
    for offset in answer.result.get("offsets", ()):
        value, deviation = offset["value"] * 1000.0, offset["deviation"] * 1000.0
        shown.append(f"offset {offset['region']}: {value:.2f} ± {deviation:.2f} mm, {offset['points']} points")
    if found is None:
        return Group(*shown)
    table = Table(box=SIMPLE_HEAD, title=f"Predicted TRE {found['tre'] * 1000.0:.2f} mm", title_justify="left")
    table.add_column("region")
    table.add_column("points", justify="right")
    table.add_column(f"with {found['more']} more, mm", justify="right")
    for region in found["regions"]:
        table.add_row(region["region"], str(region["points"]), f"{region['tre'] * 1000.0:.2f}")
    return Group(*shown, table, found["advice"])
