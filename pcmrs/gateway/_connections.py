"""Limits of the open connections of a link, in all and from one address."""

from __future__ import annotations

import asyncio
from collections import Counter

from pcmrs.errors import RefusalError
from pcmrs.gateway.intake import Intake

TOO_MANY = "too_many_connections"


class ConnectionLimit:
    """Places for the connections of one link.

    A place is taken when a connection is accepted, before any task serves it: so a burst of connections finds no more
    places than there are.

    Args:
        link: Name of the link, for refusals.
        intake: Counts and reports refusals.
        most: Number of places. Each needs a descriptor, of which there must be some left.
        most_of_a_host: Number of places for one address.
    """

    def __init__(self, link: str, intake: Intake, most: int, most_of_a_host: int) -> None:
        self._link = link
        self._intake = intake
        self._most = most
        self._most_of_a_host = most_of_a_host
        self._open: Counter[str] = Counter()

    def take(self, writer: asyncio.StreamWriter) -> tuple[str, int] | None:
        """Take a place for a new connection.

        Returns:
            Host and port of the peer; None if the connection was ended instead.
        """
        peer = peer_of(writer)
        if peer is None:
            writer.transport.abort()
            return None
        host = peer[0]
        for count, limit, whose in (
            (self._open[host], self._most_of_a_host, f"from {host}"),
            (self._open.total(), self._most, "in all"),
        ):
            if count >= limit:
                text = f"{count} connections are open {whose}, limit {limit}; close one that you do not need."
                self._intake.refuse(self._link, peer, RefusalError(TOO_MANY, text, count=count, limit=limit))
                writer.transport.abort()
                return None
        self._open[host] += 1
        return peer

    def free(self, peer: tuple[str, int]) -> None:
        """Free the place of a connection that has ended."""
        self._open[peer[0]] -= 1


def peer_of(writer: asyncio.StreamWriter) -> tuple[str, int] | None:
    """Return host and port of the peer; None if it has closed the connection already."""
    name = writer.get_extra_info("peername")
    return None if name is None else (name[0], name[1])
