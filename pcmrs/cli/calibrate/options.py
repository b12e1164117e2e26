"""Options that all calibrations share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from pcmrs.cli.options import CellAddress, OutputFile, address_options, json_option, plot_option, refuse_given
from pcmrs.cli.values import Finite

Option = Callable[[Callable[..., Any]], Callable[..., Any]]


@dataclass(frozen=True, slots=True)
class CalibrationLabel:
    """Description of the calibrated part, for the calibration file.

    Attributes:
        cell: ``site/cell`` that it may be used in; empty for any.
        output: Calibration file to write; None for none.
    """

    name: str
    serial: str
    cell: str
    valid_days: int
    output: Path | None


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options of gathering poses on a running cell.

    Attributes:
        count: Smallest number of poses.
        seconds: Longest wait for them, s.
        save_to: CSV file for the poses; None for none.
    """

    count: int
    seconds: float
    save_to: Path | None


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Options of what happens with the result of a calibration, and the cell that it is made for."""

    address: CellAddress
    label: CalibrationLabel
    plot: Path | None
    as_json: bool


@dataclass(frozen=True, slots=True)
class CalibrationRequest(ResultOptions):
    """Poses of a file, or poses to gather on the cell at an address, with all other shared options."""

    source: Path | LiveOptions


def calibration_options(count: int, fewest: int) -> Option:
    """Add FILE, --live and their options; the command gets them as `request`.

    Args:
        count: Default number of poses of a live calibration.
        fewest: Smallest number of poses.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def with_request(**given: Any) -> Any:
            return function(request=_request(given), **given)

        command: Callable[..., Any] = plot_option(json_option(with_request))
        for option in (*_live_options(count, fewest), *_file_options(), address_options, _file):
            command = option(command)
        return command

    return decorate


def result_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a calibration's result; the command gets them as `options`."""

    @functools.wraps(function)
    def with_options(**given: Any) -> Any:
        return function(options=ResultOptions(*_result_options(given)), **given)

    command: Callable[..., Any] = plot_option(json_option(with_options))
    for option in (*_file_options(), address_options):
        command = option(command)
    return command


_file: Option = click.argument("file", type=click.Path(path_type=Path), required=False)


def _file_options() -> tuple[Option, ...]:
    return (
        click.option(
            "--valid-days", type=click.IntRange(1, 36500), default=180, show_default=True, help="Until expiry."
        ),
        click.option("--any-cell", is_flag=True, help="Usable in any cell, not only in --site and --cell."),
        click.option("--serial", default="", help="Serial number of the part."),
        click.option("--name", default="", help="Name of the part."),
        click.option("-o", "--output", type=OutputFile(), help="Calibration file to write (TOML)."),
    )


def _live_options(count: int, fewest: int) -> tuple[Option, ...]:
    return (
        click.option("--keep", type=OutputFile(), help="Save the poses of --live in this CSV file."),
        click.option("--seconds", type=Finite(1.0), default=300.0, show_default=True, help="Longest --live."),
        click.option(
            "--poses",
            type=click.IntRange(fewest),
            default=count,
            show_default=True,
            help="Smallest number of poses with --live.",
        ),
        click.option("--live", is_flag=True, help="Measure the poses on the running cell."),
    )


def _request(given: dict[str, Any]) -> CalibrationRequest:
    """Remove the shared options from the given ones, and return them."""
    file, live = given.pop("file"), given.pop("live")
    if live == (file is not None):
        raise click.UsageError("give either a FILE of poses or --live.")
    if not live:
        refuse_given(("poses", "seconds", "keep", "robot"), "is for --live only: here the poses are those of FILE.")
    gather = LiveOptions(given.pop("poses"), given.pop("seconds"), given.pop("keep"))
    return CalibrationRequest(*_result_options(given), source=gather if file is None else file)


def _result_options(given: dict[str, Any]) -> tuple[CellAddress, CalibrationLabel, Path | None, bool]:
    """Remove the options of the result from the given ones, and return them."""
    address = given.pop("address")
    cell = "" if given.pop("any_cell") else f"{address.site}/{address.cell}"
    label = CalibrationLabel(given.pop("name"), given.pop("serial"), cell, given.pop("valid_days"), given.pop("output"))
    return address, label, given.pop("plot"), given.pop("as_json")
