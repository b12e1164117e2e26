"""Entry points of installed packages, read once: the standard library reads those of all packages at each call."""

from __future__ import annotations

import functools
import sys
from importlib.metadata import EntryPoint, entry_points
from typing import Any


def entry_points_of(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, in the order in which Python finds their packages.

    Args:
        group: Name of the group, such as ``pcmrs.drivers``.
    """
    return list(_read(tuple(sys.path)).select(group=group))


@functools.cache
def _read(_path: tuple[str, ...]) -> Any:
    return entry_points()
