"""Sends commands to the daemon on behalf of a page, and reports the results to the person."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nicegui import background_tasks, ui

from pcmrs.client import Client
from pcmrs.console._history import why
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.messages import Verdict


class CommandSender:
    """Sender of one page; all pages share the console's connection.

    Args:
        feed: Feed with the client.
        texts: Texts in the language of the page.
    """

    def __init__(self, feed: LiveFeed, texts: Texts) -> None:
        self._feed, self._texts = feed, texts

    async def ask(self, name: str, arguments: Mapping[str, Any]) -> Verdict | None:
        """Send a command and return its verdict; None if none came. It continues if the page is closed.

        Args:
            name: ``branch.operation``.
            arguments: Arguments of the operation.
        """
        client = self._reached()
        if client is None:
            return None
        task = background_tasks.create(_verdict(client, name, arguments), name=f"ask {name}")
        verdict: Verdict | PcmrsError = await task
        if isinstance(verdict, PcmrsError):
            look = self._texts("unknown_look") if isinstance(verdict, UnknownOutcomeError) else ""
            text = f"{verdict.text} {look}".rstrip()
            ui.notify(text, type="negative", multi_line=True, position="bottom-left")
            return None
        text = self._texts("asked", name=name, decision=verdict.decision)
        ui.notify(
            f"{text} {why(verdict)}".rstrip(),
            type="positive" if verdict.decision == "accepted" else "warning",
            multi_line=True,
            position="bottom-left",
        )
        return verdict

    async def hold(self, operation: str) -> None:
        """Take, take over or release the lease."""
        try:
            await self._feed.hold(operation)
        except PcmrsError as error:
            ui.notify(error.text, type="warning", multi_line=True, position="bottom-left")

    async def stop(self) -> None:
        """Stop everything."""
        client = self._reached()
        if client is None:
            return
        try:
            await client.stop()
        except PcmrsError as error:
            ui.notify(error.text, type="negative", multi_line=True, position="bottom-left")

    def _reached(self) -> Client | None:
        if self._feed.client is None:
            ui.notify(
                self._texts("unreachable", why=self._feed.trouble),
                type="negative",
                multi_line=True,
                position="bottom-left",
            )
        return self._feed.client


async def _verdict(client: Client, name: str, arguments: Mapping[str, Any]) -> Verdict | PcmrsError:
    try:
        return await client.call(name, arguments)
    except PcmrsError as error:
        return error
