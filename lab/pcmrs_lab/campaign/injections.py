"""All faults that can be injected."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from pcmrs_lab.campaign import faults
from pcmrs_lab.campaign.fault import REGISTERED, Injection


def injections() -> dict[str, list[Injection]]:
    """Return all injections by the id of their fault."""
    for module in iter_modules(faults.__path__):
        import_module(f"{faults.__name__}.{module.name}")
    return REGISTERED
