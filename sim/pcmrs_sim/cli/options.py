"""Options that the commands of virtual devices share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from pcmrs.cli.values import Finite
from pcmrs.config import merge_tables, set_values

F = TypeVar("F", bound=Callable[..., Any])

host_option = click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")


def cell_options(function: F) -> F:
    """Add the options of the simulated cell to a command, which then gets `settings` and `schedule`."""

    @functools.wraps(function)
    def command(*, seed: int, phantom: str, model: str, overrides: tuple[str, ...], **options: Any) -> Any:
        settings: dict[str, Any] = {"sim": {"seed": seed, "phantom": phantom}, "robot": {"model": model}}
        values: dict[str, Any] = {}
        set_values(values, overrides)
        # As on a real arm, the driver guards the force, and not the arm itself.
        return function(settings=merge_tables(merge_tables(settings, values), {"robot": {"driver": "kst"}}), **options)

    return _with(
        cast(F, command),
        click.option(
            "--schedule",
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            metavar="FILE",
            help="File of faults: lines such as '5.0 occlude coil' (time in s, then the fault).",
        ),
        click.option(
            "--set",
            "overrides",
            multiple=True,
            metavar="KEY=VALUE",
            help="A setting, such as sim.tracker.rate_hz=20.",
        ),
        click.option("--model", default="iiwa14", show_default=True, help="Model of the arm."),
        click.option(
            "--phantom", type=click.Choice(["head", "femur"]), default="head", show_default=True, help="Body part."
        ),
        click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all errors."),
    )


def world_options(function: F) -> F:
    """Add the options of a served world: those of the cell, and `duration` and `as_json`."""
    return _with(
        cell_options(function),
        click.option("--duration", type=Finite(min=0.0), metavar="S", help="End after this time, s."),
        click.option("--json", "as_json", is_flag=True, help="Print the addresses as one line of JSON."),
    )


def _with(command: F, *options: Callable[[F], F]) -> F:
    for option in options:
        command = option(command)
    return command
