"""A router between cells and people: both connect to it, and it carries the messages that the register permits."""

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
    """Return the bus settings of a router: with certificates only, and without an endpoint on loopback.

    Args:
        identity: Folder of the identity that the authority has issued for the router.
        register: File of the register: everyone who may take part.
        listen: Endpoints at which it listens, such as ``tls/0.0.0.0:7449``.

    Raises:
        ConfigurationError: Identity or register cannot be used.
    """
    own, members = read_credentials(identity, SystemClock().wall()), tuple(read_register(register))
    check_registered(own, members, "router")
    return BusSettings(mode="router", endpoint="", listen=tuple(listen), credentials=own, members=members)


@asynccontextmanager
async def routing(settings: BusSettings) -> AsyncIterator[None]:
    """Carry messages for the length of the block.

    Raises:
        BusError: The router cannot listen.
        ConfigurationError: An endpoint has no certificates.
    """
    loop = asyncio.get_running_loop()
    session = await loop.run_in_executor(None, open_session, settings)
    try:
        yield
    finally:
        await loop.run_in_executor(None, session.close)
