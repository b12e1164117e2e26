"""Command groups that import the module of a command when it is used: their help imports nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click
from click.exceptions import NoSuchCommand

from pcmrs.installed import entry_points_of
from pcmrs.visible import visible

if TYPE_CHECKING:
    # For annotations only: it loads more than everything else here.
    from importlib.metadata import EntryPoint

LABORATORY: Final = "pcmrs-lab"
"""Distribution with the commands of the laboratory."""
ENTRY_POINTS: Final = "pcmrs.commands"
"""Group of the entry points with which other distributions add commands: ``name``, or ``group.name``."""


WHOLE: Final = 1000
"""Limit of a command's description in the help of its group, characters: longer than any."""


class LazyCommand(NamedTuple):
    """One command of a group.

    Attributes:
        place: Its ``module:function``, or the distribution that adds it.
        summary: First sentence of its help text, for the help of the group; empty if its module is imported for that.
        hidden: True to leave it out of the help.
    """

    place: str
    summary: str = ""
    hidden: bool = False


class LazyGroup(click.Group):
    """Group that finds commands by name and imports only the requested one.

    Args:
        commands: Names of the commands, in the order of the help.
        prefix: Prefix of the entry points that add further commands; None if none are looked for.
        sections: Headings of the help, with the names of the commands below them; all others are below "Commands".
        options: Further options, see `click.Group`.
    """

    def __init__(
        self,
        *,
        commands: Mapping[str, LazyCommand],
        prefix: str | None = None,
        sections: Mapping[str, Sequence[str]] = MappingProxyType({}),
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self._listed = commands
        self._prefix = prefix
        self._sections = sections

    def list_commands(self, _context: click.Context) -> list[str]:
        others = self._entry_points()
        known = [name for name, each in self._listed.items() if ":" in each.place or name in others]
        return known + sorted(others.keys() - self._listed.keys())

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        place = self._listed[name].place if name in self._listed else ""
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

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that the words name, or fail with the names that are close."""
        try:
            return super().resolve_command(ctx, args)
        except NoSuchCommand as error:  # it knows no command that is loaded later
            raise NoSuchCommand(error.command_name, possibilities=self.list_commands(ctx), ctx=ctx) from None

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke the command; what a usage error quotes, such as the name of a file, is escaped."""
        try:
            return super().invoke(ctx)
        except click.ClickException as error:
            # click has no other place between what raises an error and what prints it.
            error.message = visible(error.message, keep="\n")  # type: ignore[misc]
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a row for each command below the heading of its section, with its whole first sentence."""
        commands = {name: self._described(ctx, name) for name in self.list_commands(ctx)}
        shown = {name: command for name, command in commands.items() if command is not None and not command.hidden}
        placed = {name for names in self._sections.values() for name in names}
        others = [name for name in shown if name not in placed]
        for heading, names in (*self._sections.items(), ("Commands", others)):
            rows = [(name, shown[name].get_short_help_str(WHOLE)) for name in names if name in shown]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)

    def _described(self, context: click.Context, name: str) -> click.Command | None:
        """Return a command with the help text of the command `name`, or that command itself."""
        listed = self._listed.get(name)
        if listed is not None and (listed.summary or listed.hidden):
            return click.Command(name, help=listed.summary, hidden=listed.hidden)
        return self.get_command(context, name)

    def _entry_points(self) -> dict[str, EntryPoint]:
        if self._prefix is None:
            return {}
        names = {point.name.removeprefix(self._prefix): point for point in entry_points_of(ENTRY_POINTS)}
        return {name: point for name, point in names.items() if self._prefix + name == point.name and "." not in name}
