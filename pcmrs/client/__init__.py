"""Clients of a running cell: `Client` for asyncio, `PlainClient` for programs without asyncio."""

from pcmrs.client._aio import Client, Event
from pcmrs.client._plain import PlainClient

__all__ = ["Client", "Event", "PlainClient"]
