"""What the daemon would say to the plan, while it is edited."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from pcmrs.client import Client
from pcmrs.console.feed import Feed
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError
from pcmrs.messages import DryRunResult
from pcmrs.messages.identity import COMMANDING
from pcmrs.messages.setup import Setup

ASKED = 0.4
"""Between two looks at whether there is something new to ask, s: each answer takes time of the daemon."""

Requests = Sequence[tuple[str, Mapping[str, Any]]]


class Checking:
    """A line that says whether the plan would be accepted.

    Args:
        feed: Has the client.
        setup: Of the cell: who may not plan does not ask.
        texts: Of the page's language.
    """

    def __init__(self, feed: Feed, setup: Setup, texts: Texts) -> None:
        self._feed, self._texts = feed, texts
        self._may_ask = setup.role in COMMANDING
        self._wanted: Requests | None = None
        self._line = ui.label().classes("w-full").props('data-testid="check"')
        ui.timer(ASKED, self._look)

    def of(self, requests: Requests) -> None:
        """Have a plan looked at, one request after the other; none leaves the line empty."""
        self._wanted = requests

    async def _look(self) -> None:
        if self._wanted is None or not self._may_ask:
            return
        wanted, self._wanted = self._wanted, None
        client = self._feed.client
        if client is None or not wanted:
            self._line.set_text("")
            return
        try:
            prospects = await self._answers(client, wanted)
        except PcmrsError as error:
            text, colour = error.text, OPEN
        else:
            text, colour = said(prospects, self._texts)
        if self._wanted is None:
            self._line.set_text(text)
            self._line.classes(replace=f"w-full {colour}")

    async def _answers(self, client: Client, wanted: Requests) -> list[DryRunResult]:
        """Up to the first refusal, or until there is something newer."""
        found: list[DryRunResult] = []
        for name, arguments in wanted:
            found.append(await client.check(name, arguments))
            if found[-1].reason is not None or self._wanted is not None:
                break
        return found


GOOD, OPEN, BAD = "text-green-9", "text-grey-9", "text-orange-10"


def said(prospects: Sequence[DryRunResult], texts: Texts) -> tuple[str, str]:
    """The line, and its colour. Of several prospects the first is of the whole, the others of its points in order."""
    last = prospects[-1]
    if last.reason is not None:
        point = "" if len(prospects) < 2 else texts("check_point", number=len(prospects) - 1) + " "
        return f"✗ {point}{last.reason.text}", BAD
    undecided = [text for each in prospects for text in each.undecided]
    if undecided:
        return f"? {undecided[0]}", OPEN
    errors = [each.result["tre"] for each in prospects if "tre" in each.result]
    if not errors:
        return f"✓ {texts('check_good')}", GOOD
    return f"✓ {texts('check_reachable', mm=1000.0 * max(errors))}", GOOD
