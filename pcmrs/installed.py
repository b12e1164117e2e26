"""Entry points of installed packages, read once: the standard library reads those of all packages at each call."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # For annotations only: it loads the packages for e-mail and archives, and most commands need no entry point.
    from importlib.metadata import EntryPoint


def entry_points_of(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, in the order in which Python finds their packages.

    Args:
        group: Name of the group, such as ``pcmrs.drivers``.
    """
    return list(_read(tuple(sys.path)).select(group=group))


@functools.cache
def _read(_path: tuple[str, ...]) -> Any:
    from importlib.metadata import entry_points

    return entry_points()
