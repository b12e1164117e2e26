"""Requirements of a test on the machine: programs, rights, kernel features."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

__all__ = ["ROOT", "Need", "module", "program"]


@dataclass(frozen=True, slots=True)
class Need:
    """Requirement that a machine meets or does not meet.

    Attributes:
        name: Name for reports.
        is_met: Function that returns whether this machine, and this process on it, meets it.
    """

    name: str
    is_met: Callable[[], bool]


ROOT = Need("root", lambda: os.geteuid() == 0)
"""Requirement of the rights of root."""


def program(name: str) -> Need:
    """Return the requirement of a program on the search path."""
    return Need(name, lambda: shutil.which(name) is not None)


def module(name: str) -> Need:
    """Return the requirement of an installed Python module."""
    return Need(name, lambda: find_spec(name) is not None)
