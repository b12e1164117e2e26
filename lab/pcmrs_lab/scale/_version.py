"""Version of everything that decides the result of a task."""

from __future__ import annotations

import platform
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path

import pcmrs
import pcmrs_lab
import pcmrs_sim

COMPUTING = ("coal", "mujoco", "numpy", "pin", "ruckig", "scipy")
"""Distributions whose arithmetic is in the results."""


@cache
def code_version() -> str:
    """Return a hash of our installed files, and of the versions of Python and of the distributions that compute.

    The number of a release is not enough: a checkout has the same number before and after an edit.
    """
    digest = blake2b(digest_size=16)
    for part in (platform.python_version(), *(f"{name} {version(name)}" for name in COMPUTING)):
        digest.update(f"{part}\n".encode())
    for package in (pcmrs, pcmrs_sim, pcmrs_lab):
        folder = Path(package.__path__[0])
        for path in sorted(each for each in folder.rglob("*") if each.is_file() and "__pycache__" not in each.parts):
            digest.update(f"{package.__name__} {path.relative_to(folder)} {path.stat().st_size}\n".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
