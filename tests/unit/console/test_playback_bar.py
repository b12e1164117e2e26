"""The bar of a replay: it plays at the chosen speed, ends at the end, and says what cannot be shown."""

from __future__ import annotations

from typing import Any

import pytest
from nicegui import ui

from pcmrs.console._playback_bar import PERIOD, PlaybackBar, choose_recording, refuse_recording, wait_for_recording
from tests.unit.console.detached_page import ENGLISH, DetachedPage


class Recorded:
    started_at = 1_700_000_000.0
    duration = 10 * PERIOD


class Played:
    """A playback that only keeps its position."""

    recorded = Recorded()
    trouble = ""
    position = 0.0

    def seek(self, position: float) -> None:
        self.position = position


class Folder:
    """Recordings of which one is being read."""

    progress, trouble, is_read = 0.25, "", False

    def __init__(self, *names: str) -> None:
        self._names = list(names)

    def names(self) -> list[str]:
        return self._names


def bar(page: DetachedPage, played: Any) -> None:
    with page.client:
        PlaybackBar(played, "run", ENGLISH)


async def test_it_plays_on_by_its_speed_and_stops_at_the_end(page: DetachedPage) -> None:
    played = Played()
    bar(page, played)
    await page.tick()
    assert played.position == 0.0, "nothing plays before the button is pressed"
    await page.press("play")
    await page.tick()
    assert played.position == pytest.approx(PERIOD)
    page.only(ui.toggle).set_value(4)
    for _ in range(5):
        await page.tick()
    assert played.position == pytest.approx(Recorded.duration)
    assert page.at("play").props["icon"] == "play_arrow"
    await page.press("play")
    assert played.position == 0.0, "at the end it begins again"
    await page.press("play")
    await page.tick()
    assert played.position == 0.0, "it is paused"


async def test_the_slider_seeks_and_the_time_is_that_of_the_session(page: DetachedPage) -> None:
    played = Played()
    bar(page, played)
    page.at("moment").set_value(0.5)
    assert played.position == 0.5
    assert page.text("recorded-time").endswith("0.5 / 1 s")
    assert page.text("recorded-time").startswith("2023-11-1")


def test_damage_of_the_recording_stays_in_view(page: DetachedPage) -> None:
    played = Played()
    played.trouble = "The last 10 bytes are lost."
    bar(page, played)
    assert "The last 10 bytes are lost." in page.everything


def test_without_recordings_there_is_nothing_to_choose(page: DetachedPage) -> None:
    none: Any = Folder()
    choose_recording(none, ENGLISH)
    assert page.everything == []
    some: Any = Folder("b", "a")
    choose_recording(some, ENGLISH)
    assert page.at("recordings").value == "b", "the newest"


async def test_progress_or_the_reason_is_shown_while_one_waits(page: DetachedPage) -> None:
    folder: Any = Folder("a")
    with page.client:
        wait_for_recording(folder, ENGLISH)
    await page.tick()
    assert page.only(ui.linear_progress).value == 0.25
    assert page.text("trouble") == ""
    folder.trouble = "a.mcap is no recording."
    await page.tick()
    assert page.text("trouble") == "a.mcap is no recording."


def test_a_refused_recording_says_why(page: DetachedPage) -> None:
    refuse_recording("It is of another arm.", ENGLISH)
    assert page.text("trouble") == "It is of another arm."
