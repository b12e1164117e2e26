"""Discovery of running cells: each process of a cell declares a liveliness token, ``alive/<component>``."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Final

from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.messages.identity import EVERY_CELL

_REPLY_TIME: Final = 1.5
"""Longest wait for liveliness tokens, s."""


async def find_cells(settings: BusSettings) -> dict[str, list[str]]:
    """Return the connected components of each cell, by ``<site>/<cell>``; only cells in which the caller has a role.

    Raises:
        BusError: No router answers at the endpoint, or it refuses the connection.
        ConfigurationError: The endpoint is on another machine and there are no credentials.
    """
    cells = EVERY_CELL if settings.credentials is None else settings.credentials.cells
    return await asyncio.get_running_loop().run_in_executor(None, _find, settings, cells)


def _find(settings: BusSettings, cells: Iterable[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    with open_session(settings) as session:
        for each in cells:
            for reply in session.liveliness().get(f"pcmrs/{each}/alive/*", timeout=_REPLY_TIME):
                if reply.ok is not None:
                    _, site, cell, _, component = str(reply.ok.key_expr).split("/")
                    found.setdefault(f"{site}/{cell}", []).append(component)
    return {cell: sorted(set(components)) for cell, components in sorted(found.items())}
