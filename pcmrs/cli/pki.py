"""`pcmrs pki`: certificates for all people and processes that take part over a network."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pcmrs.cli.lazy import LazyCommand, LazyGroup
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json, write_document
from pcmrs.cli.running import readable_errors
from pcmrs.cli.tables import Terminal
from pcmrs.messages.identity import ROLES, Role

if TYPE_CHECKING:
    # For annotations only: asking for help must not load a library for certificates.
    from pcmrs.messages.identity import Identity

COMMANDS = {name: LazyCommand(f"pcmrs.cli.pki:{name}") for name in ("init", "issue", "revoke", "roles")}
COMMANDS |= {"list": LazyCommand("pcmrs.cli.pki:list_"), "device-key": LazyCommand("pcmrs.cli.pki:device_key")}

folder_option = click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("pki"),
    envvar="PCMRS_PKI",
    show_default=True,
    help="Folder of the authority.",
)


@click.group(cls=LazyGroup, commands=COMMANDS)
def pki() -> None:
    """Manage the certificates of a lab: its own authority, and one identity for each person and process.

    Keep the authority's folder on a separate machine, with a copy: anyone who has its key can impersonate anybody.
    """


@click.command()
@click.option("--site", default="lab", envvar="PCMRS_SITE", show_default=True, help="Name of the lab.")
@folder_option
@json_option
@readable_errors
def init(site: str, folder: Path, as_json: bool) -> None:
    """Make the authority of a lab; it is valid for ten years.

    Exit status: 0 made, 5 the folder cannot be written, 4 there is an authority already.

    Example: pcmrs pki init --folder ~/pki
    """
    from pcmrs.pki import Authority

    authority = Authority.init(folder, site, _now())
    if as_json:
        say_json({"folder": str(authority.folder)})
    else:
        say(f"{folder} is the authority of {site}. Now issue: pcmrs pki issue operator NAME --folder {folder}")


@click.command()
@click.argument("role", type=click.Choice(ROLES))
@click.argument("name")
@click.option("--days", type=float, default=30.0, show_default=True, help="Days until it must be issued again.")
@click.option(
    "--host", "hosts", multiple=True, help="Name or address at which a daemon or router is dialled; may be repeated."
)
@click.option(
    "--cell",
    "cells",
    multiple=True,
    metavar="SITE/CELL",
    required=True,
    help="Cell in which it may do that, such as lab/cell1 or lab/*; may be repeated.",
)
@click.option(
    "--via",
    multiple=True,
    metavar="ROUTER",
    help="Name of a router that may forward this person's messages; may be repeated.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path(),
    show_default="the working directory",
    help="Folder in which the folder NAME with certificate, key and authority is made.",
)
@folder_option
@json_option
@readable_errors
def issue(
    role: Role,
    name: str,
    days: float,
    hosts: tuple[str, ...],
    cells: tuple[str, ...],
    via: tuple[str, ...],
    output: Path,
    folder: Path,
    as_json: bool,
) -> None:
    """Give NAME a certificate for ROLE, with a new key; again for one that ends soon, with all its options.

    NAME is part of this identity's own bus keys, such as cmd/NAME/**. Exit status: 0 issued, 5 the files
    cannot be written, 4 name, role, hosts, cells or routers are not possible.

    Example: pcmrs pki issue operator anna --days 7 --cell lab/cell1
    """
    from pcmrs.pki import Authority

    issued = Authority(folder).issue(role, name, _now(), days=days, hosts=hosts, cells=cells, via=via, into=output)
    if as_json:
        say_json(issued)
    else:
        say(f"{issued.folder}: certificate and key of the {role} {name}, valid until {_day(issued.identity.ends)}.")
        say("Move the folder over a secure channel to the machine that uses it, and delete it here.")


@click.command("device-key")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@json_option
@readable_errors
def device_key(file: Path, as_json: bool) -> None:
    """Make the key that a daemon shares with device nodes on other machines, as a new FILE with mode 0600.

    Both sides name their copy as access.device_key. Nodes that the daemon starts itself need none. Exit status: 0
    made, 5 it cannot be written, 4 there is such a file.

    Example: pcmrs pki device-key device.key
    """
    from pcmrs.bus.seal import write_key

    write_key(file)
    if as_json:
        say_json({"file": str(file)})
    else:
        say(f"{file}: copy it over a secure channel to the machine of each device node.")


@click.command()
@click.argument("name")
@folder_option
@json_option
@readable_errors
def revoke(name: str, folder: Path, as_json: bool) -> None:
    """Revoke NAME permanently; this takes effect when the routers are restarted with the new register.

    Exit status: 0 revoked, 5 the register cannot be written, 4 nobody has this name, or it is revoked already.

    Example: pcmrs pki revoke anna
    """
    from pcmrs.pki import Authority

    identity = Authority(folder).revoke(name, _now())
    if as_json:
        say_json(identity)
    else:
        say(f"{name} is revoked. Give routers and daemons the new register, and restart them.")


@click.command("list")
@folder_option
@json_option
@readable_errors
def list_(folder: Path, as_json: bool) -> None:
    """List all identities that have been issued.

    Example: pcmrs pki list
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from pcmrs.pki import Authority

    identities = Authority(folder).identities()
    if as_json:
        say_json(identities)
        return
    table, now = Table("name", "role", "cells", "via", "until", "state", box=SIMPLE_HEAD), _now()
    for each in identities:
        table.add_row(
            each.name, each.role, " ".join(each.cells), " ".join(each.via), _day(each.ends), _state(each, now)
        )
    Terminal().print(table)


@click.command()
@json_option
@readable_errors
def roles(as_json: bool) -> None:
    """Print what each role may do on the bus: the table behind the access control of routers and daemons."""
    from pcmrs.bus.access import roles_as_markdown
    from pcmrs.bus.keys import KEYS

    if as_json:
        say_json(KEYS)
    else:
        write_document(roles_as_markdown())


def _state(identity: Identity, now: float) -> str:
    if identity.revoked is not None:
        return f"revoked {_day(identity.revoked)}"
    return "valid" if identity.valid(now) else "expired"


def _day(wall: float) -> str:
    return f"{datetime.datetime.fromtimestamp(wall, datetime.UTC):%Y-%m-%d %H:%M} UTC"


def _now() -> float:
    from pcmrs.clock import SystemClock

    return SystemClock().wall()
