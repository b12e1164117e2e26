"""Which cells are there: every process of a cell says so by a liveliness token, ``alive/<component>``."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Final

from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.messages.identity import EVERY_CELL

_PATIENCE: Final = 1.5


async def find_cells(settings: BusSettings) -> dict[str, list[str]]:
    """Cells, as ``<site>/<cell>``, to the components that are connected; only cells in which one has a role.

    Raises:
        BusError: Nobody answers at the endpoint, or lets us in.
        ConfigurationError: An endpoint on another machine, and no credentials.
    """
    cells = EVERY_CELL if settings.credentials is None else settings.credentials.cells
    return await asyncio.get_running_loop().run_in_executor(None, _find, settings, cells)


def _find(settings: BusSettings, cells: Iterable[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    with open_session(settings) as session:
        for each in cells:
            for reply in session.liveliness().get(f"pcmrs/{each}/alive/*", timeout=_PATIENCE):
                if reply.ok is not None:
                    _, site, cell, _, component = str(reply.ok.key_expr).split("/")
                    found.setdefault(f"{site}/{cell}", []).append(component)
    return {cell: sorted(set(components)) for cell, components in sorted(found.items())}
