"""The daemon's answer to the plan, while it is edited."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from pcmrs.client import Client
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console.texts import Texts
from pcmrs.errors import PcmrsError
from pcmrs.messages import DryRunResult
from pcmrs.messages.identity import COMMANDING
from pcmrs.messages.setup import Setup

CHECK_PERIOD = 0.4
"""Period of checking for a changed plan, s: each answer takes time of the daemon."""

Requests = Sequence[tuple[str, Mapping[str, Any]]]


class PlanCheck:
    """A line that says whether the daemon would accept the plan.

    Args:
        feed: Feed with the client.
        setup: Setup of the cell: users who may not plan do not ask.
        texts: Texts in the language of the page.
    """

    def __init__(self, feed: LiveFeed, setup: Setup, texts: Texts) -> None:
        self._feed, self._texts = feed, texts
        self._may_ask = setup.role in COMMANDING
        self._wanted: Requests | None = None
        self._line = ui.label().classes("w-full").props('data-testid="check"')
        ui.timer(CHECK_PERIOD, self._look)

    def check(self, requests: Requests) -> None:
        """Check a plan, one request after the other; without requests the line is empty."""
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
            results = await self._answers(client, wanted)
        except PcmrsError as error:
            text, colour = error.text, OPEN
        else:
            text, colour = describe_results(results, self._texts)
        if self._wanted is None:
            self._line.set_text(text)
            self._line.classes(replace=f"w-full {colour}")

    async def _answers(self, client: Client, wanted: Requests) -> list[DryRunResult]:
        """Return the answers up to the first refusal, or until there is a newer plan."""
        found: list[DryRunResult] = []
        for name, arguments in wanted:
            found.append(await client.check(name, arguments))
            if found[-1].reason is not None or self._wanted is not None:
                break
        return found


GOOD, OPEN, BAD = "text-green-9", "text-grey-9", "text-orange-10"


def describe_results(results: Sequence[DryRunResult], texts: Texts) -> tuple[str, str]:
    """Return the line and its colour.

    Args:
        results: Answers; of several, the first is of the whole plan, the others of its points in order.
        texts: Texts in the language of the page.
    """
    last = results[-1]
    if last.reason is not None:
        point = "" if len(results) < 2 else texts("check_point", number=len(results) - 1) + " "
        return f"✗ {point}{last.reason.text}", BAD
    undecided = [text for each in results for text in each.undecided]
    if undecided:
        return f"? {undecided[0]}", OPEN
    errors = [each.result["tre"] for each in results if "tre" in each.result]
    if not errors:
        return f"✓ {texts('check_good')}", GOOD
    return f"✓ {texts('check_reachable', mm=1000.0 * max(errors))}", GOOD
