"""The bus: one Zenoh session per process, typed messages, and the daemon's edge for commands."""

from pcmrs.bus._session import Bus
from pcmrs.bus.codec import Empty
from pcmrs.bus.commands import CommandEdge
from pcmrs.bus.keys import KEYS, KeyInfo, KeyTable
from pcmrs.bus.settings import DEFAULT_ENDPOINT, BusSettings, Credentials

__all__ = [
    "DEFAULT_ENDPOINT",
    "KEYS",
    "Bus",
    "BusSettings",
    "CommandEdge",
    "Credentials",
    "Empty",
    "KeyInfo",
    "KeyTable",
]
