"""The timeline: newest first, filtered, and only what a role has received if it may not read the journal."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.console._history import HistoryEntry
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console._timeline import ROWS, TimelinePanel
from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import DeviceEvent, JournalPage, JournalQuery
from pcmrs.messages.identity import Role
from tests.unit.console.detached_page import ENGLISH, DetachedPage
from tests.unit.console.shown_cell import setup


def feed_with(*entries: HistoryEntry) -> LiveFeed:
    dial: Any = None
    feed = LiveFeed(dial)
    feed.history.entries.extend(entries)
    return feed


def entry(number: int, kind: str = "outcome", what: str = "robot.connect: accepted", who: str = "anna") -> HistoryEntry:
    return HistoryEntry(number, 1.7e9 + number, kind, "s", who, what, "")


def panel(page: DetachedPage, feed: LiveFeed, role: Role = "operator") -> TimelinePanel:
    with page.client:
        made = TimelinePanel(feed, feed, msgspec.structs.replace(setup(), role=role, patient="P. 7"), ENGLISH)
    made.refresh()
    return made


def numbers(page: DetachedPage) -> list[int]:
    return [row["number"] for row in page.at("timeline").rows]


async def test_newest_rows_are_first_and_activities_are_hidden(page: DetachedPage) -> None:
    feed = feed_with(*(entry(number) for number in range(1, ROWS + 20)), entry(1000, kind="activity"))
    panel(page, feed)
    assert numbers(page) == list(range(ROWS + 19, 19, -1))
    assert "P. 7" in page.text("patient")


async def test_a_filter_finds_words_in_any_case(page: DetachedPage) -> None:
    made = panel(page, feed_with(entry(1), entry(2, what="placement.home: rejected"), entry(3, who="Ben")))
    for text, found in (("HOME", [2]), ("ben", [3]), ("nothing", []), ("", [3, 2, 1])):
        page.at("filter").set_value(text)
        made.refresh()
        assert numbers(page) == found
    page.at("kinds").set_value(["device"])
    made.refresh()
    assert numbers(page) == []


async def test_a_role_without_the_journal_sees_what_was_received(page: DetachedPage) -> None:
    feed = feed_with(entry(1))
    feed.events.append((1.7e9, DeviceEvent(device="robot", code="link_lost", text="Gone.")))
    panel(page, feed, role="planner")
    assert [(row["what"], row["result"]) for row in page.at("timeline").rows] == [("robot: link_lost", "Gone.")]
    assert ENGLISH("heard_only") in page.everything
    assert not page.at("earlier").visible


async def test_earlier_rows_are_read_on_request(page: DetachedPage) -> None:
    class Daemon:
        answers = False

        async def journal(self, _: JournalQuery) -> JournalPage:
            if not self.answers:
                raise UnknownOutcomeError("It is silent.")
            return JournalPage(rows=[])

    feed, daemon = feed_with(entry(5)), Daemon()
    panel(page, feed)
    await page.press("earlier")
    assert page.notified == [], "without a daemon there is nobody to ask"
    feed.client = daemon  # type: ignore[assignment]
    await page.press("earlier")
    assert page.notified == ["It is silent."]
    assert page.at("earlier").visible
    daemon.answers = True
    await page.press("earlier")
    assert not page.at("earlier").visible, "there is nothing before"
