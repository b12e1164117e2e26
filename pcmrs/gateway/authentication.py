"""Who a signed datagram is from: a configured peer whose tag holds, and whose counter has grown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pcmrs.clock import Clock
from pcmrs.dispatcher.bucket import TokenBucket
from pcmrs.errors import RefusalError
from pcmrs.gateway.commands import Action, Spec
from pcmrs.gateway.keys import read_key
from pcmrs.gateway.permissions import allowed
from pcmrs.gateway.settings import PeerConfig
from pcmrs.gateway.signing import Signed
from pcmrs.messages.identity import Asker

UNKNOWN_PEER = "unknown_peer"
BAD_TAG = "bad_tag"
OLD_COUNTER = "old_counter"
NOT_ALLOWED = "not_allowed"
OVER_RATE = "over_rate"


class SignedPeer:
    """A configured peer.

    Args:
        name: Its name.
        config: Its key, commands and rate.
        newest: The largest counter that it has sent so far, in earlier runs too.
        clock: The machine's clock.

    Attributes:
        name: Its name.
        waiting: How many of its commands wait until their counters are kept.

    Raises:
        ConfigurationError: Its key cannot be used.
    """

    def __init__(self, name: str, config: PeerConfig, newest: int, clock: Clock) -> None:
        self.name = name
        self.waiting = 0
        self._key = read_key(Path(config.key_file).expanduser())
        self._config = config
        self._allowed = allowed(config.allow)
        self._newest = newest
        self._bucket = TokenBucket(config.rate, config.burst, clock)

    @property
    def source(self) -> str:
        """Who it is, as the daemon records it, whatever address it has."""
        return f"peer:{self.name}"

    @property
    def asker(self) -> Asker:
        """Who asks, and what they may do."""
        return Asker(self.name, self._config.role)

    def accept(self, signed: Signed) -> None:
        """Takes a datagram as this peer's, and its counter as used.

        Raises:
            RefusalError: The tag does not hold, or the counter has not grown.
        """
        if not signed.holds(self._key):
            raise RefusalError(BAD_TAG, f"The tag is not one of {self.name!r}: use its key, and sign every byte.")
        if signed.counter <= self._newest:
            raise RefusalError(
                OLD_COUNTER,
                f"The counter of {self.name!r} is {signed.counter}, and {self._newest} was used; count on from there.",
                counter=signed.counter,
                newest=self._newest,
            )
        self._newest = signed.counter

    def objection(self, spec: Spec) -> RefusalError | None:
        """Why it may not give this command now; Stop may always be given."""
        if spec.action is Action.STOP:
            return None
        if not self._bucket.take():
            limits = f"{self._config.rate:g} per second after {self._config.burst}"
            return RefusalError(OVER_RATE, f"{self.name!r} sends more than {limits}; send less, or raise its rate.")
        if spec.name not in self._allowed:
            text = f"{self.name!r} may not give {spec.name}; list it in gateway.peers.{self.name}.allow."
            return RefusalError(NOT_ALLOWED, text, peer=self.name, command=spec.name)
        return None


def authenticate(peers: Mapping[str, SignedPeer], signed: Signed) -> SignedPeer:
    """The peer that a datagram is from; its counter is used from now on.

    Raises:
        RefusalError: The peer is not known, the tag does not hold, or the counter has not grown.
    """
    peer = peers.get(signed.peer)
    if peer is None:
        raise RefusalError(UNKNOWN_PEER, f"{signed.peer!r} is no peer; add [gateway.peers.{signed.peer}] with its key.")
    peer.accept(signed)
    return peer
