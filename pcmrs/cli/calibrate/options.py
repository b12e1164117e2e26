"""Options that both calibrations share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from pcmrs.cli.options import Address, OutputFile, address_options, json_option, plot_option, refuse_given
from pcmrs.cli.values import Finite

Option = Callable[[Callable[..., Any]], Callable[..., Any]]


@dataclass(frozen=True, slots=True)
class About:
    """What the calibration file is to say of the thing, and where it is written.

    Attributes:
        cell: ``site/cell`` it may be used in; empty for any.
        output: Nothing is written where it is None.
    """

    name: str
    serial: str
    cell: str
    valid_days: int
    output: Path | None


@dataclass(frozen=True, slots=True)
class Live:
    """How poses are gathered on a running cell.

    Attributes:
        count: So many poses at least.
        seconds: The longest wait for them.
        keep: Where they are kept as CSV.
    """

    count: int
    seconds: float
    keep: Path | None


@dataclass(frozen=True, slots=True)
class Asked:
    """What was asked for: poses of a file, or gathered on the cell at an address."""

    source: Path | Live
    address: Address
    about: About
    plot: Path | None
    as_json: bool


def calibration_options(count: int, fewest: int) -> Option:
    """Add FILE, --live and what both need; the command gets them as `asked`.

    Args:
        count: Poses of a live calibration, where nobody asks for more or less.
        fewest: So many at least.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def with_asked(**given: Any) -> Any:
            return function(asked=_asked(given), **given)

        command: Callable[..., Any] = plot_option(json_option(with_asked))
        for option in (*_live_options(count, fewest), *_file_options(), address_options, _file):
            command = option(command)
        return command

    return decorate


_file: Option = click.argument("file", type=click.Path(path_type=Path), required=False)


def _file_options() -> tuple[Option, ...]:
    return (
        click.option(
            "--valid-days", type=click.IntRange(1, 36500), default=180, show_default=True, help="Until expiry."
        ),
        click.option("--any-cell", is_flag=True, help="Usable in any cell, not only in --site and --cell."),
        click.option("--serial", default="", help="Serial number of the thing."),
        click.option("--name", default="", help="Name of the thing."),
        click.option("-o", "--output", type=OutputFile(), help="Calibration file to write (TOML)."),
    )


def _live_options(count: int, fewest: int) -> tuple[Option, ...]:
    return (
        click.option("--keep", type=OutputFile(), help="Keep the poses of --live in this CSV file."),
        click.option("--seconds", type=Finite(1.0), default=300.0, show_default=True, help="Longest --live."),
        click.option(
            "--poses", type=click.IntRange(fewest), default=count, show_default=True, help="Fewest of --live."
        ),
        click.option("--live", is_flag=True, help="Take the poses from the running cell."),
    )


def _asked(given: dict[str, Any]) -> Asked:
    """Take the shared options out of what was given."""
    file, live, address = given.pop("file"), given.pop("live"), given.pop("address")
    if live == (file is not None):
        raise click.UsageError("give either a FILE of poses or --live.")
    if not live:
        refuse_given(("poses", "seconds", "keep", "robot"), "is for --live only: the poses are those of FILE.")
    gather = Live(given.pop("poses"), given.pop("seconds"), given.pop("keep"))
    cell = "" if given.pop("any_cell") else f"{address.site}/{address.cell}"
    about = About(given.pop("name"), given.pop("serial"), cell, given.pop("valid_days"), given.pop("output"))
    return Asked(gather if file is None else file, address, about, given.pop("plot"), given.pop("as_json"))
