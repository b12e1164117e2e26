"""What a fault needs of a machine: programs, rights, parts of the kernel."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass


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
