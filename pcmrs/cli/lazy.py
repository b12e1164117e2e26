"""Command groups whose commands' modules are loaded when they are used: asking for help loads nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import click


class LazyGroup(click.Group):
    """Finds commands by name and imports only the one that is asked for.

    Args:
        commands: Name of each command to ``module:function``.
        given: See `click.Group`.
    """

    def __init__(self, *, commands: Mapping[str, str], **given: Any) -> None:
        super().__init__(**given)
        self._places = commands

    def list_commands(self, _context: click.Context) -> list[str]:
        return list(self._places)

    def get_command(self, _context: click.Context, name: str) -> click.Command | None:
        if name not in self._places:
            return None
        module, _, function = self._places[name].partition(":")
        command: click.Command = getattr(import_module(module), function)
        return command
