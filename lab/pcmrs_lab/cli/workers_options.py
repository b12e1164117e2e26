"""Options of the commands that run many seeded tasks: --workers, --cluster and --finished."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from pcmrs_lab.scale.tasks import Workers

MOST = 64
"""Number of workers on one machine from which a number is probably a mistake."""


def workers_options(number: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add the options; the command gets them as `workers`.

    Args:
        number: Default number of workers on this machine.
    """

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def command(cluster: str, finished: Path | None, workers: int | None, **given: Any) -> Any:
            if cluster and workers is not None:
                raise click.UsageError("--workers is a number on this machine: leave it out beside --cluster.")
            return function(workers=Workers(number if workers is None else workers, cluster, finished), **given)

        for option in _options(number):
            command = option(command)
        return command

    return add


def _options(number: int) -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--finished",
            type=click.Path(dir_okay=False, writable=True, path_type=Path),
            metavar="FILE.jsonl",
            help="Append each finished task to this file, and do not run again what it has.",
        ),
        click.option(
            "--cluster",
            default="",
            metavar="ADDRESS",
            help="Run on the workers of this Dask scheduler instead, such as tls://scheduler:8786.",
        ),
        click.option(
            "--workers",
            type=click.IntRange(1, MOST),
            show_default=str(number),
            help="Number of worker processes on this machine.",
        ),
    )
