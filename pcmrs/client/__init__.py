"""Clients of a running cell: `Client` for asyncio, `PlainClient` for programs without asyncio."""

from pcmrs.bus import DEFAULT_ENDPOINT, Credentials
from pcmrs.client._aio import Client, Event
from pcmrs.client._plain import PlainClient

__all__ = ["DEFAULT_ENDPOINT", "Client", "Credentials", "Event", "PlainClient"]
