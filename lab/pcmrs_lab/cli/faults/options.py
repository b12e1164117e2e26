"""Which faults a command is about."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pcmrs.errors import ConfigurationError

if TYPE_CHECKING:
    from pcmrs_lab.campaign.catalogue import Row

F = TypeVar("F", bound=Callable[..., Any])


class PartOf(click.ParamType[tuple[int, int]]):
    """The k-th of n parts, written ``k/n``, as two numbers."""

    name = "k/n"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Both numbers, or a usage error."""
        number, _, parts = str(value).partition("/")
        if not (number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts)):
            self.fail(f"{value!r} is no part: write 2/3 for the second of three.", param, ctx)
        return int(number), int(parts)


def choosing(function: F) -> F:
    """Adds --class and --id; the command gets them as `classes` and `ids`."""
    for option in (
        click.option("--id", "ids", multiple=True, metavar="ID", help="Only this fault, such as S3; may be repeated."),
        click.option(
            "--class",
            "classes",
            multiple=True,
            metavar="CLASS",
            help="Only operator, sensor, robot, network, process, storage, clock, adversary or order; may be repeated.",
        ),
    ):
        function = option(function)
    return function


def chosen(classes: Sequence[str], ids: Sequence[str]) -> list[Row]:
    """The rows that are asked for; a usage error when there is no such class or fault."""
    from pcmrs_lab.campaign.catalogue import choose

    try:
        return choose(classes, ids)
    except ConfigurationError as error:
        raise click.UsageError(error.text) from None
