"""Signed peers: a datagram is authentic if its tag is right and its counter has grown; its age is limited."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pcmrs.bucket import TokenBucket
from pcmrs.clock import Clock
from pcmrs.errors import RefusalError
from pcmrs.gateway.commands import TREAT, Action, Spec, allowed
from pcmrs.gateway.peer_session import ReplyChannel, Send
from pcmrs.gateway.settings import UNIX_NS, PeerConfig
from pcmrs.gateway.signing import Signed, read_key, sign_answer
from pcmrs.messages.identity import Principal

UNKNOWN_PEER = "unknown_peer"
BAD_TAG = "bad_tag"
OLD_COUNTER = "old_counter"
NOT_ALLOWED = "not_allowed"
OVER_RATE = "over_rate"
TOO_OLD = "too_old"
CLOCK_AHEAD = "clock_ahead"
FRESH_FOR = 2.0
"""Limit of the difference between the clock of a peer and ours, including the transmission, s."""


class SignedPeer:
    """A configured peer.

    Args:
        name: Its name.
        config: Its key, commands and rate.
        newest: The largest counter that it has sent so far, also in earlier runs.
        clock: The machine's clock.

    Attributes:
        name: Its name.
        newest: The largest counter that it has used.
        waiting: Number of its commands that wait until their counters are stored.

    Raises:
        ConfigurationError: Its key cannot be used.
    """

    def __init__(self, name: str, config: PeerConfig, newest: int, clock: Clock) -> None:
        self.name = name
        self.waiting = 0
        self._key = read_key(Path(config.key_file).expanduser())
        self._config = config
        self._allowed = allowed(config.allow)
        self.newest = newest
        self._clock = clock
        self._bucket = TokenBucket(config.rate, config.burst, clock)

    @property
    def source(self) -> str:
        """Source of its commands in the journal, whatever its address."""
        return f"peer:{self.name}"

    @property
    def asker(self) -> Principal:
        """User of its commands, and their role."""
        return Principal(self.name, self._config.role)

    @property
    def for_surgeon(self) -> bool:
        """True if it may state in the surgeon's name what only the surgeon can state."""
        return TREAT in self._config.allow

    def accept(self, signed: Signed) -> None:
        """Accept a datagram as this peer's, and mark its counter as used.

        A counter that is a time in the future is not marked: otherwise the peer could send nothing, not even Stop,
        between the correction of its clock and that time.

        Raises:
            RefusalError: The tag is wrong, or the counter has not grown.
        """
        if not signed.holds(self._key):
            raise RefusalError(BAD_TAG, f"The tag is not one of {self.name!r}: use its key, and sign every byte.")
        if signed.counter <= self.newest:
            raise RefusalError(
                OLD_COUNTER,
                f"The counter of {self.name!r} is {signed.counter}, and {self.newest} was used; count on from there.",
                counter=signed.counter,
                newest=self.newest,
            )
        if self._age(signed.counter) >= -FRESH_FOR:
            self.newest = signed.counter

    def objection(self, spec: Spec, counter: int) -> RefusalError | None:
        """Return why it may not send a command now; None if it may. Stop is always allowed.

        Args:
            spec: The command.
            counter: Counter of the datagram.
        """
        if spec.action is Action.STOP:
            return None
        age = self._age(counter)
        if age > FRESH_FOR:
            return RefusalError(
                TOO_OLD,
                f"A command of {self.name!r} is {age:.1f} s old, the limit is {FRESH_FOR:g} s: it was held back on its "
                "way, or the clock of that machine is behind ours. Set both clocks, by NTP for example.",
                peer=self.name,
                age=age,
                limit=FRESH_FOR,
            )
        if age < -FRESH_FOR:
            return RefusalError(
                CLOCK_AHEAD,
                f"The clock of {self.name!r} is {-age:.1f} s ahead of ours, the limit is {FRESH_FOR:g} s. Set both "
                "clocks, by NTP for example.",
                peer=self.name,
                ahead=-age,
                limit=FRESH_FOR,
            )
        if not self._bucket.take():
            limits = f"{self._config.rate:g} per second after {self._config.burst}"
            return RefusalError(OVER_RATE, f"{self.name!r} sends more than {limits}; send less, or raise its rate.")
        if spec.name not in self._allowed:
            text = f"{self.name!r} may not give {spec.name}; list it in gateway.peers.{self.name}.allow."
            return RefusalError(NOT_ALLOWED, text, peer=self.name, command=spec.name)
        return None

    def signs(self, answer: ReplyChannel, counter: int) -> ReplyChannel:
        """Return the channel of the answers to a command; answers to a peer with a clock are signed.

        Args:
            answer: Channel to the peer.
            counter: Counter of the command.
        """
        if not self._timed:
            return answer
        acknowledge = answer.acknowledge
        return ReplyChannel(
            verdict=self._signing(answer.verdict, counter),
            acknowledge=None if acknowledge is None else self._signing(acknowledge, counter),
        )

    @property
    def _timed(self) -> bool:
        return self._config.counter == UNIX_NS

    def _age(self, counter: int) -> float:
        """Time since the peer signed, s; 0 if its counter is not a time."""
        return self._clock.wall() - counter * 1e-9 if self._timed else 0.0

    def _signing(self, send: Send, counter: int) -> Send:
        return lambda text: send(sign_answer(text, self.name, counter, self._key))


def authenticate(peers: Mapping[str, SignedPeer], signed: Signed) -> SignedPeer:
    """Return the peer that a datagram is from, and mark its counter as used.

    Args:
        peers: The configured peers by name.
        signed: The datagram.

    Raises:
        RefusalError: The peer is unknown, the tag is wrong, or the counter has not grown.
    """
    peer = peers.get(signed.peer)
    if peer is None:
        text = f"{signed.peer!r} is not a peer; add [gateway.peers.{signed.peer}] with its key."
        raise RefusalError(UNKNOWN_PEER, text)
    peer.accept(signed)
    return peer
