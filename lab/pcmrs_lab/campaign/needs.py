"""What a fault needs of a machine: programs, rights, parts of the kernel."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec


@dataclass(frozen=True, slots=True)
class Need:
    """Something that a machine has or has not.

    Attributes:
        name: Under which it is listed.
        is_met: Whether this machine, and this process on it, has it.
    """

    name: str
    is_met: Callable[[], bool]


ROOT = Need("root", lambda: os.geteuid() == 0)


def program(name: str) -> Need:
    """A program on the search path."""
    return Need(name, lambda: shutil.which(name) is not None)


def module(name: str) -> Need:
    """A Python module that is installed."""
    return Need(name, lambda: find_spec(name) is not None)
