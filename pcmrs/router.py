"""A router in the middle: cells and people dial it, and it carries what the register lets them do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from pcmrs.bus import BusSettings
from pcmrs.bus.settings import open_session
from pcmrs.clock import SystemClock
from pcmrs.pki import check_registered, read_credentials, read_register


def router_settings(identity: Path, register: Path, listen: Sequence[str]) -> BusSettings:
    """How a router joins the bus: with certificates only, and without a place for its own machine.

    Args:
        identity: Folder that the authority has issued for it.
        register: Everybody who may take part.
        listen: Endpoints, such as ``tls/0.0.0.0:7449``.

    Raises:
        ConfigurationError: Identity or register cannot be used.
    """
    own, members = read_credentials(identity, SystemClock().wall()), tuple(read_register(register))
    check_registered(own, members, "router")
    return BusSettings(mode="router", endpoint="", listen=tuple(listen), credentials=own, members=members)


@asynccontextmanager
async def routing(settings: BusSettings) -> AsyncIterator[None]:
    """Carries messages for the length of the block.

    Raises:
        BusError: It cannot listen.
        ConfigurationError: An endpoint is not one with certificates.
    """
    loop = asyncio.get_running_loop()
    session = await loop.run_in_executor(None, open_session, settings)
    try:
        yield
    finally:
        await loop.run_in_executor(None, session.close)
