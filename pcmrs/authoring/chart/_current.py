"""Limits of a chart: how deep it can be, and which states may be highlighted."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint

MAX_LEVEL = 64
"""Deepest level that is drawn; each level takes some width from all others."""


def check_current(blueprint: Blueprint, current: Mapping[str, str] | None) -> dict[str, str]:
    """Return the states to highlight, branch to state.

    Args:
        blueprint: The workflow.
        current: States to highlight, branch to state; None for none.

    Raises:
        ConfigurationError: The workflow has no such branch or state; the text lists those that it has. Or it is
            nested too deeply to be drawn.
    """
    deepest = max(branch.level for branch in blueprint.branches.values())
    if deepest > MAX_LEVEL:
        raise ConfigurationError(f"{blueprint.id} has {deepest} levels; {MAX_LEVEL} can be drawn", levels=deepest)
    for name, state in (current or {}).items():
        if name not in blueprint.branches:
            known = ", ".join(blueprint.branches)
            raise ConfigurationError(f"{blueprint.id} has no branch {name!r}; its branches are {known}", branch=name)
        if state not in blueprint.branches[name].states:
            known = ", ".join(blueprint.branches[name].states)
            text = f"{blueprint.id}.{name} has no state {state!r}; its states are {known}"
            raise ConfigurationError(text, branch=name, state=state)
    return dict(current or {})
