"""Extras of the distribution: the base install has the client, the command line and the state machines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pcmrs.errors import ConfigurationError

EXTRAS: Final[Mapping[str, tuple[str, ...]]] = {
    "daemon": ("coal", "pinocchio", "prometheus_client", "ruckig", "scipy", "threadpoolctl", "trimesh", "uvloop"),
    "recording": ("foxglove", "mcap", "zstandard"),
    "report": ("jinja2", "matplotlib", "plutoprint"),
    "authoring": ("resvg_py",),
    "hardware": ("ndicapy", "pyigtl", "pylsl", "serial"),
    "console": ("nicegui", "fastapi", "uvicorn"),
    "imaging": ("fast_simplification", "nibabel", "pydicom", "skimage"),
    "teleop": ("evdev",),
    "ros2": ("pycdr2",),
}
"""Name of an extra to the modules that it brings and that are imported."""


def extra_of(module: str) -> str | None:
    """Return the extra that brings a module, such as ``scipy.linalg``; None for a module of no extra."""
    return next((extra for extra, modules in EXTRAS.items() if module.partition(".")[0] in modules), None)


def missing_extra(error: ModuleNotFoundError) -> ConfigurationError | None:
    """Return the error that names the extra to install; None if the module belongs to no extra."""
    extra = extra_of(error.name or "")
    if extra is None:
        return None
    text = f"The package {error.name} is missing: install the extra {extra} (docs/supply.md)."
    return ConfigurationError(text, package=error.name, extra=extra)
