"""Verdicts by (source, id), so that a repeated command runs nothing."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, Final, Generic, Protocol, TypeVar

import msgspec

from pcmrs.dispatcher.events import Recorder
from pcmrs.errors import RefusalError
from pcmrs.messages import Command, Verdict
from pcmrs.messages.clipping import clipped

MAX_REMEMBERED = 10_000
"""Commands of which a cache keeps an entry; older ones are looked up in the journal."""
ID_REUSED: Final = "id_reused"
"""Code of the refusal of a command whose id the same source has used for another one."""


class CacheEntry(Protocol):
    """Entry of one command."""

    def done(self) -> bool:
        """Return whether the command has ended."""


E = TypeVar("E", bound=CacheEntry)


class CommandCache(Generic[E]):
    """Bounded map from source and id of a command to its entry, such as a future of its verdict.

    Beyond `MAX_REMEMBERED` entries the oldest is forgotten, but never one of a command that has not ended: a repeat of
    that command would be taken for a new one, and perform it again.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, str], E] = OrderedDict()

    def get(self, source: str, command_id: str) -> E | None:
        """Return the entry of a command; None for a new one.

        Args:
            source: Source of the command.
            command_id: Id that the source has given it.
        """
        return self._entries.get((source, command_id))

    def put(self, source: str, command_id: str, entry: E) -> None:
        """Store the entry of a command, and forget the oldest if there are too many.

        Args:
            source: Source of the command.
            command_id: Id that the source has given it.
            entry: The entry.
        """
        self._entries[source, command_id] = entry
        if len(self._entries) > MAX_REMEMBERED:
            key, oldest = next(iter(self._entries.items()))
            if oldest.done():
                del self._entries[key]
            else:
                self._entries.move_to_end(key)

    def remove(self, source: str, command_id: str) -> None:
        """Forget a command, if it is known.

        Args:
            source: Source of the command.
            command_id: Id that the source has given it.
        """
        self._entries.pop((source, command_id), None)


@dataclass(frozen=True, slots=True)
class _Known:
    """A command that has been decided or is being decided: digest of its content, and its verdict."""

    digest: bytes
    verdict: asyncio.Future[Verdict]

    def done(self) -> bool:
        return self.verdict.done()


class VerdictCache:
    """Verdicts of the commands that have been decided or are being decided, backed by the journal.

    Args:
        recorder: The journal.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._known: CommandCache[_Known] = CommandCache()

    def verdict_of(self, command: Command) -> tuple[asyncio.Future[Verdict], bool]:
        """Return the verdict of a command, done or to come, and whether the command is new.

        Raises:
            RefusalError: ``id_reused``: the same source has used this id for another command.
            JournalError: The journal cannot say whether the command has been decided before.
        """
        key, digest = (command.source, command.id), _digest(command.branch, command.operation, command.arguments)
        known = self._known.get(*key)
        if known is not None:
            _check_same(command, digest, known.digest)
            return known.verdict, False
        recorded = self._recorder.recall(*key)
        verdict: asyncio.Future[Verdict] = asyncio.get_running_loop().create_future()
        if recorded is not None:
            answer = recorded.verdict
            clipped_digest = _digest(command.branch, command.operation, clipped(command.arguments))
            _check_same(command, clipped_digest, _digest(answer.branch, answer.operation, clipped(recorded.arguments)))
            verdict.set_result(answer)
        self._known.put(*key, _Known(digest, verdict))
        return verdict, recorded is None

    def forget(self, command: Command) -> None:
        """Forget a verdict that was not made durable: the journal's counts."""
        self._known.remove(command.source, command.id)

    @staticmethod
    def settle(verdict: asyncio.Future[Verdict], answer: Verdict) -> None:
        """Give a verdict to everybody who waits for it, unless it has been given.

        Args:
            verdict: Future of the verdict.
            answer: The verdict.
        """
        if not verdict.done():
            verdict.set_result(answer)


def _digest(branch: str, operation: str, arguments: Mapping[str, Any]) -> bytes:
    """Digest of a command's content: arguments may be long, and are not stored just to be compared."""
    content = msgspec.json.encode((branch, operation, arguments), enc_hook=repr, order="sorted")
    return blake2b(content, digest_size=16).digest()


def _check_same(command: Command, digest: bytes, before: bytes) -> None:
    if digest != before:
        other = f"another operation or other arguments than {command.branch}.{command.operation} now"
        raise id_reused(command.source, command.id, other)


def id_reused(source: str, command_id: str, other: str) -> RefusalError:
    """Return the refusal of a command whose id has been used for another one.

    Args:
        source: Source of both commands.
        command_id: Id that the source has given them.
        other: The other command, as far as it is known.
    """
    text = f"{source} has used the id {command_id!r} before, for {other}: give every command its own id."
    return RefusalError(ID_REUSED, text, id=command_id)


async def wait_for_verdicts(verdicts: list[asyncio.Future[Verdict]]) -> None:
    """Return when all verdicts are given; cancelling the waiter does not cancel them."""
    if verdicts:
        await asyncio.wait(verdicts)
