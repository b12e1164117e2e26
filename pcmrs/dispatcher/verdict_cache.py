"""Verdicts by (source, id), so that a repeated command runs nothing."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Mapping
from hashlib import blake2b
from typing import Any

import msgspec

from pcmrs.dispatcher.recorder import Recorder, clipped
from pcmrs.errors import RefusalError
from pcmrs.messages import Command, Verdict

MAX_REMEMBERED = 10_000
"""Verdicts kept in memory; older ones are looked up in the journal."""

Key = tuple[str, str]
"""Source and id of a command."""


class VerdictCache:
    """Remembers what has been decided, and what is being decided."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._known: OrderedDict[Key, tuple[bytes, asyncio.Future[Verdict]]] = OrderedDict()

    def verdict_of(self, command: Command) -> tuple[asyncio.Future[Verdict], bool]:
        """The verdict of a command, done or to come, and whether the command is new.

        Raises:
            RefusalError: ``id_reused``: the same source has asked for something else by this id.
            JournalError: Nobody can say whether the command has been decided before.
        """
        key, asked = (command.source, command.id), _digest(command.branch, command.operation, command.arguments)
        if key in self._known:
            before, verdict = self._known[key]
            _check_same(command, asked, before)
            return verdict, False
        recorded = self._recorder.recall(*key)
        verdict = asyncio.get_running_loop().create_future()
        if recorded is not None:
            answer = recorded.verdict
            kept = _digest(command.branch, command.operation, clipped(command.arguments))
            _check_same(command, kept, _digest(answer.branch, answer.operation, clipped(recorded.arguments)))
            verdict.set_result(answer)
        self._known[key] = asked, verdict
        self._forget_oldest()
        return verdict, recorded is None

    def forget(self, command: Command) -> None:
        """What has been answered was not made durable: what the journal says counts."""
        self._known.pop((command.source, command.id), None)

    @staticmethod
    def settle(verdict: asyncio.Future[Verdict], answer: Verdict) -> None:
        """Gives the verdict to everybody who waits for it."""
        if not verdict.done():
            verdict.set_result(answer)

    def _forget_oldest(self) -> None:
        if len(self._known) > MAX_REMEMBERED:
            key, (_, verdict) = next(iter(self._known.items()))
            if verdict.done():
                del self._known[key]
            else:
                self._known.move_to_end(key)


def _digest(branch: str, operation: str, arguments: Mapping[str, Any]) -> bytes:
    """Of what is asked: arguments may be long, and are not kept for the sake of a comparison."""
    asked = msgspec.json.encode((branch, operation, arguments), enc_hook=repr, order="sorted")
    return blake2b(asked, digest_size=16).digest()


def _check_same(command: Command, asked: bytes, before: bytes) -> None:
    if asked != before:
        text = (
            f"{command.source} has used the id {command.id!r} before, for another operation or other arguments than "
            f"{command.branch}.{command.operation} now: give every command an id of its own."
        )
        raise RefusalError("id_reused", text, id=command.id)


async def wait_for_verdicts(verdicts: list[asyncio.Future[Verdict]]) -> None:
    """Return when all verdicts are given; cancelling the waiter does not cancel them."""
    if verdicts:
        await asyncio.wait(verdicts)
