"""Extras of the distribution: the base install holds the client, the command line and the state machines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pcmrs.errors import ConfigurationError

EXTRAS: Final[Mapping[str, tuple[str, ...]]] = {
    "daemon": (
        "coal",
        "pinocchio",
        "prometheus_client",
        "ruckig",
        "scipy",
        "setproctitle",
        "threadpoolctl",
        "trimesh",
        "uvloop",
    ),
    "recording": ("foxglove", "mcap", "zstandard"),
    "report": ("jinja2", "matplotlib", "plutoprint", "scipy", "threadpoolctl"),
    "authoring": ("httpx", "resvg_py"),
    "hardware": ("ndicapy", "pyigtl", "pylsl", "serial"),
    "console": ("fastapi", "nicegui", "uvicorn"),
    "imaging": ("fast_simplification", "nibabel", "pydicom", "skimage", "trimesh"),
    "teleop": ("evdev",),
    "ros2": ("pycdr2",),
    "archive": ("duckdb", "psycopg", "pyarrow"),
}
"""Imported modules of each extra."""

POSIX: Final = frozenset({"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"})
"""Modules of the standard library that Windows does not have."""


def missing_module(error: ModuleNotFoundError) -> ConfigurationError | None:
    """Return an error that names the extra of a missing module; None if it belongs to no extra."""
    module = (error.name or "").partition(".")[0]
    if module in POSIX:
        text = f"This needs {module}, which Windows does not have: run it on Linux."
        return ConfigurationError(text, module=module)
    extras = [extra for extra, modules in EXTRAS.items() if module in modules]
    if not extras:
        return None
    text = f"The package {module} is missing: install the extra {' or '.join(extras)} (docs/supply.md)."
    return ConfigurationError(text, package=module, extras=extras)
