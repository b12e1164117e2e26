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
    """Adds which world there is, and for how long.

    The command gets `settings`, `schedule`, `duration` and `as_json`.
    """

    @functools.wraps(function)
    def command(*, seed: int, phantom: str, model: str, overrides: tuple[str, ...], **given: Any) -> Any:
        settings: dict[str, Any] = {"sim": {"seed": seed, "phantom": phantom}, "robot": {"model": model}}
        values: dict[str, Any] = {}
        set_values(values, overrides)
        # The arm does not guard the force by itself: that is the driver's, as on a real arm.
        return function(settings=merge_tables(merge_tables(settings, values), {"robot": {"driver": "kst"}}), **given)

    for option in (
        click.option("--json", "as_json", is_flag=True, help="Say where it listens as one line of JSON."),
        click.option("--duration", type=Finite(min=0.0), metavar="S", help="End after so many seconds."),
        click.option(
            "--schedule",
            type=click.Path(exists=True, dir_okay=False, path_type=Path),
            metavar="FILE",
            help="Faults to come: lines such as '5.0 occlude coil'.",
        ),
        click.option(
            "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="As of pcmrs-serve: sim.tracker.rate_hz=20."
        ),
        click.option("--model", default="iiwa14", show_default=True, help="The arm."),
        click.option(
            "--phantom", type=click.Choice(["head", "femur"]), default="head", show_default=True, help="The body."
        ),
        click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of all errors."),
    ):
        command = option(command)
    return command
