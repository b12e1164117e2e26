"""Options that several commands share."""

from __future__ import annotations

import functools
import os
from collections.abc import AsyncIterator, Callable, Collection
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the bus.
    from pcmrs.bus import Credentials
    from pcmrs.client import Client

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class CellAddress:
    """Address of a cell."""

    endpoint: str
    site: str
    cell: str
    identity: Path | None = None

    @asynccontextmanager
    async def connect(self) -> AsyncIterator[Client]:
        """Return a client of the running daemon.

        Raises:
            BusError: There is none, or it refuses this client.
            ConfigurationError: The identity cannot be used.
        """
        from pcmrs.client import Client

        async with Client.connect(self.endpoint, self.site, self.cell, credentials=self.credentials()) as client:
            yield client

    def credentials(self) -> Credentials | None:
        """Return the credentials of the identity; None on the cell's own machine.

        Raises:
            ConfigurationError: The identity cannot be used.
        """
        if self.identity is None:
            return None
        from pcmrs.clock import SystemClock
        from pcmrs.pki import read_credentials  # loads a library for certificates

        return read_credentials(self.identity, SystemClock().wall())


identity_option = click.option(
    "--identity",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="PCMRS_IDENTITY",
    metavar="FOLDER",
    help="Folder with your certificate and key from pcmrs pki issue; needed from other machines.",
)


def address_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add --endpoint, --site, --cell and --identity; the command gets them as `address`."""

    @functools.wraps(function)
    def command(*, endpoint: str, site: str, cell: str, identity: Path | None, **given: Any) -> Any:
        return function(address=CellAddress(endpoint, site, cell, identity), **given)

    for option in (
        identity_option,
        click.option("--cell", default="cell1", envvar="PCMRS_CELL", show_default=True, help="Name of the cell."),
        click.option("--site", default="lab", envvar="PCMRS_SITE", show_default=True, help="Site of the cell."),
        click.option(
            "--endpoint",
            default="tcp/127.0.0.1:7447",
            envvar="PCMRS_ENDPOINT",
            show_default=True,
            help="Endpoint of the daemon's bus, or of a router: tls/HOST:PORT with --identity.",
        ),
    ):
        command = option(command)
    return command


def config_options(function: F) -> F:
    """Add --config and --set."""
    for option in (
        click.option(
            "--set",
            "overrides",
            multiple=True,
            metavar="KEY=VALUE",
            help="Set one value, such as robot.model=iiwa7; may be repeated.",
        ),
        click.option(
            "--config",
            "file",
            type=click.Path(path_type=Path),
            help="TOML file with all settings that differ from the defaults.",
        ),
    ):
        function = option(function)
    return function


class OutputFile(click.Path):
    """A file that can probably be written: minutes of work must not be lost to a misspelt folder."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, writable=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or fail with a usage error."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if not path.parent.is_dir():
            self.fail(f"{path} cannot be written: there is no folder {path.parent}; create it first.", param, ctx)
        return path


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")

plot_option = click.option("--plot", type=OutputFile(), metavar="FILE.png", help="Also draw a picture.")


def refuse_given(names: Collection[str], why: str) -> None:
    """Refuse parameters that would be ignored: a user who gives one expects an effect.

    Args:
        names: Names of the parameters.
        why: Reason, after the name of the parameter.
    """
    context = click.get_current_context()
    for option in context.command.params:
        if option.name in names and context.get_parameter_source(option.name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{option.opts[0]} {why}")
