"""Clients of a running cell: `Client` for asyncio, `PlainClient` for programs without asyncio."""

from pcmrs.client.aio import Client, Event
from pcmrs.client.plain import PlainClient

__all__ = ["Client", "Event", "PlainClient"]
