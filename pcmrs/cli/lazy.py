"""Command groups that load the module of a command when it is used: help loads nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import EntryPoint
from typing import Any, Final

import click

from pcmrs.installed import entry_points_of
from pcmrs.visible import visible

LABORATORY: Final = "pcmrs-lab"
"""Distribution with the commands of the laboratory."""
ENTRY_POINTS: Final = "pcmrs.commands"
"""Group of the entry points with which other distributions add commands: ``name``, or ``group.name``."""


class LazyGroup(click.Group):
    """Finds commands by name and imports only the requested one.

    Args:
        commands: Name of each command to ``module:function``, or to the distribution that adds it.
        prefix: Prefix of the entry points that add further commands; None if none are looked for.
        options: Further options, see `click.Group`.
    """

    def __init__(self, *, commands: Mapping[str, str], prefix: str | None = None, **options: Any) -> None:
        super().__init__(**options)
        self._places = commands
        self._prefix = prefix

    def list_commands(self, _context: click.Context) -> list[str]:
        others = self._entry_points()
        known = [name for name, place in self._places.items() if ":" in place or name in others]
        return known + sorted(others.keys() - self._places.keys())

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        place = self._places.get(name, "")
        try:
            if ":" in place:
                module, _, function = place.partition(":")
                command: click.Command = getattr(import_module(module), function)
                return command
            if (point := self._entry_points().get(name)) is not None:
                command = point.load()
                return command
        except ModuleNotFoundError as error:
            from pcmrs.cli.running import fail_missing  # loads what prints errors

            fail_missing(error)
        if place:
            text = f"'{context.command_path} {name}' is a command of {place}, which is not installed (docs/supply.md)."
            raise click.UsageError(text, context)
        return None

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke the command; what a usage error quotes, such as the name of a file, is escaped."""
        try:
            return super().invoke(ctx)
        except click.ClickException as error:
            # click has no other place between what raises an error and what prints it.
            error.message = visible(error.message, keep="\n")  # type: ignore[misc]
            raise

    def _entry_points(self) -> dict[str, EntryPoint]:
        if self._prefix is None:
            return {}
        names = {point.name.removeprefix(self._prefix): point for point in entry_points_of(ENTRY_POINTS)}
        return {name: point for name, point in names.items() if self._prefix + name == point.name and "." not in name}
