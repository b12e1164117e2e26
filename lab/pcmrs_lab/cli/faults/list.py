"""`pcmrs faults list`: the catalogue, and which faults can be injected on this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click
import msgspec

from pcmrs.cli.options import json_option
from pcmrs.cli.running import readable_errors
from pcmrs.cli.tables import print_report, styled
from pcmrs_lab.cli.faults.options import choosing, chosen

if TYPE_CHECKING:
    from rich.table import Table

    from pcmrs_lab.campaign.catalogue import CatalogueRow


class ListedFault(msgspec.Struct, frozen=True, rename={"fault_class": "class"}):
    """One listed fault.

    Attributes:
        how: Means of injection; empty if there is none.
        needs: Requirements on the machine: programs, rights, kernel features.
        missing: Requirements that this machine does not meet.
        runs: True if it can be injected here in all its ways.
    """

    id: str
    fault_class: str
    title: str
    required: str
    reference: str
    how: list[str]
    needs: list[str]
    missing: list[str]
    runs: bool


class Listing(msgspec.Struct, frozen=True):
    """Faults in the order of the catalogue."""

    faults: list[ListedFault]


@click.command("list")
@choosing
@json_option
@readable_errors
def list_(classes: tuple[str, ...], ids: tuple[str, ...], as_json: bool) -> None:
    """List the faults of the catalogue: the required response, how each is injected, and what that needs.

    Example: pcmrs faults list --class storage
    """
    listing = Listing([_listed(row) for row in chosen(classes, ids)])
    print_report(listing, _table(listing), as_json=as_json)


def _listed(row: CatalogueRow) -> ListedFault:
    from pcmrs_lab.campaign.injections import injections

    known = injections().get(row.id, [])
    needs = {need.name: need for way in known for need in way.needs}
    missing = [name for name, need in needs.items() if not need.is_met()]
    how = list(dict.fromkeys(way.how for way in known))
    return ListedFault(
        row.id,
        row.fault_class,
        row.title,
        row.required,
        row.reference,
        how,
        list(needs),
        missing,
        runs=bool(known) and not missing,
    )


def _table(listing: Listing) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs_lab.campaign.catalogue import RESPONSES
    from pcmrs_lab.campaign.run import NO_INJECTION

    caption = "; ".join(f"{letter}: {meaning}" for letter, meaning in RESPONSES.items())
    table = Table(
        "", "class", "fault", "required response", "how it is injected", "needs", box=SIMPLE_HEAD, caption=caption
    )
    for row in listing.faults:
        how = "; ".join(row.how) or NO_INJECTION
        needs = [f"{need} (missing)" if need in row.missing else need for need in row.needs]
        style = "bold red" if row.missing else ""
        table.add_row(row.id, row.fault_class, row.title, row.required, how, styled(", ".join(needs), style=style))
    return table
