"""The lane of Stop on a simulated network: the real `StopLane`, with a session that carries presses but no queries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from pcmrs.bus.codec import pack
from pcmrs.bus.stop import Press, Stop, StopLane
from pcmrs_sim.deterministic.network import Endpoint

STOPS = "stop/*"


def open_lane(link: Endpoint, stop: Stop) -> StopLane:
    """Open the lane of a process.

    Args:
        link: Endpoint of the process on the network.
        stop: Called in the process for the presses of each source; see `StopLane`.
    """

    def stop_if_alive(source: str, presses: int) -> int | None:
        # A press may have been taken, and the process killed before the loop handles it.
        return None if link.gone else stop(source, presses)

    session: Any = _Session(link)
    return StopLane(session, link.prefix, stop_if_alive)


class _Payload(bytes):
    def to_bytes(self) -> bytes:
        return self


class _Sample(NamedTuple):
    """What `StopLane` reads of a `zenoh.Sample`."""

    key_expr: str
    payload: _Payload


class _Session:
    """What `StopLane` uses of a `zenoh.Session`; it is its own subscriber and queryable."""

    def __init__(self, link: Endpoint) -> None:
        self._link = link

    def declare_subscriber(self, _key: str, receive: Callable[[_Sample], None]) -> _Session:
        def take(key: str, press: Press) -> None:
            receive(_Sample(f"{self._link.prefix}/{key}", _Payload(pack(press))))

        self._link.subscribe(STOPS, Press, take)
        return self

    def declare_queryable(self, _key: str, _receive: Callable[[Any], None]) -> _Session:
        return self

    def undeclare(self) -> None:
        self._link.end(STOPS)

    def close(self) -> None:
        """Do nothing: the endpoint is that of the process."""
