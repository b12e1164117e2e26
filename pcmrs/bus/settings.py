"""Where a process meets its cell, and the Zenoh session that follows from it."""

from __future__ import annotations

import json
from typing import Any, Literal

import msgspec
import zenoh

from pcmrs.errors import BusError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


class BusSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bus as one process uses it.

    Attributes:
        mode: The daemon is the ``router`` that listens; every other process is a ``client`` of it.
        endpoint: Where the router listens.
        site: First name of the cell.
        cell: Second name of the cell.
    """

    mode: Literal["router", "client"] = "client"
    endpoint: str = DEFAULT_ENDPOINT
    site: str = "lab"
    cell: str = "cell1"


def open_session(settings: BusSettings) -> zenoh.Session:
    """Opens the session; blocks for as long as that takes.

    Raises:
        BusError: The endpoint is taken (``router``) or nobody answers there (``client``).
    """
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError as error:
        if settings.mode == "router":
            text = f"Cannot listen on {settings.endpoint}: another daemon is there, or the address is not ours."
        else:
            text = f"No daemon answers at {settings.endpoint}: start pcmrs-serve, or give its endpoint."
        raise BusError(text, endpoint=settings.endpoint) from error


def _config(settings: BusSettings) -> zenoh.Config:
    """Router or client, nothing else found by multicast or gossip."""
    is_router = settings.mode == "router"
    values: dict[str, Any] = {
        "mode": settings.mode,
        "listen/endpoints": [settings.endpoint] if is_router else [],
        "connect/endpoints": [] if is_router else [settings.endpoint],
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # A router waits this long for scouted peers before it is open; there are none.
        "scouting/delay": 0,
        "transport/link/tx/lease": 1000,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
        "transport/shared_memory/enabled": False,
    }
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config
