"""Programs of the machine that a fault needs: a missing or failing one makes it not run, never passed or failed."""

from __future__ import annotations

import pytest

from pcmrs.testing.needs import Need, program
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.tools import ended, require, tool


async def test_a_tool_that_fails_is_not_run() -> None:
    with pytest.raises(NotRun, match="sh -c echo broken; exit 3 failed here: broken"):
        await tool(["sh", "-c", "echo broken; exit 3"])


async def test_a_tool_returns_what_it_printed_on_both_streams() -> None:
    assert await tool(["sh", "-c", "echo out; echo err >&2"]) == "out\nerr\n"
    assert await ended(["sh", "-c", "echo no; exit 4"]) == (4, "no\n")


def test_missing_item_is_named() -> None:
    require([program("sh")])
    with pytest.raises(NotRun, match="missing here: no-such-program, moon;"):
        require([program("sh"), program("no-such-program"), Need("moon", lambda: False)])
