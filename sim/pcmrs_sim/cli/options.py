"""Options that the commands of virtual devices share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from pcmrs.cli.values import Finite
from pcmrs.config import merge_tables, set_values

F = TypeVar("F", bound=Callable[..., Any])

host_option = click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")


def world_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the simulated world to a command, which then gets their result.

    The command gets `settings`, `schedule`, `duration` and `as_json`.
    """

    @functools.wraps(function)
    def command(*, seed: int, phantom: str, model: str, overrides: tuple[str, ...], **options: Any) -> Any:
        settings: dict[str, Any] = {"sim": {"seed": seed, "phantom": phantom}, "robot": {"model": model}}
        values: dict[str, Any] = {}
        set_values(values, overrides)
        # As on a real arm, the driver guards the force, and not the arm itself.
        return function(settings=merge_tables(merge_tables(settings, values), {"robot": {"driver": "kst"}}), **options)

    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the addresses as one line of JSON."),
        click.option("--duration", type=Finite(min=0.0), metavar="S", help="End after this time, s."),
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
    ):
        command = option(command)
    return command
