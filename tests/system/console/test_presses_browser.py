"""Presses in a real browser: Stop beside an open dialog, and a press counts only for what was pressed."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from pcmrs.console._meaning import SETTLING_TIME
from pcmrs.testing.driving import landmarks, tool_pose
from tests.system.console.consoles import CHROMIUM, ask, browser, client_of, console, running_cell, to_registered_head
from tests.system.console.test_browser import HOLD_MS, PATIENT, Operator

pytest.importorskip("playwright")

if TYPE_CHECKING:
    from playwright.sync_api import Page

    from pcmrs.client import PlainClient

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]
SETTLED_MS = 1000.0 * SETTLING_TIME + 200.0


@pytest.fixture
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Options that reach a running cell."""
    with running_cell(tmp_path_factory.mktemp("cell"), *PATIENT) as options:
        yield options


def pointer_to(operator: Operator, name: str) -> None:
    """Move the mouse to the middle of a button, whatever covers it."""
    box = operator.at(name).bounding_box()
    assert box is not None
    operator.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def stop_by_mouse(operator: Operator, page: Page) -> None:
    pointer_to(operator, "stop")
    page.mouse.down()
    page.mouse.up()
    operator.expect(operator.at("latched")).to_be_visible(timeout=60_000)


def release_stop(cell: PlainClient) -> None:
    cell.until(lambda state: state.latched and state.stop.confirmed)
    ask(cell, "robot.acknowledge", {"stop": cell.state().stop.number})


def test_the_stop_button_stops_beside_each_open_dialog(address: list[str]) -> None:
    with client_of(address) as cell:
        to_registered_head(cell)
        with console(*address, "--consent", "confirm") as (_, url), browser(url) as page:
            operator = Operator(page)
            for name, shown in (
                ("registration.refine", "send-form"),
                ("digitization.redigitize_one", "which-landmark"),
                ("placement.approach", "move-now"),
            ):
                operator.press(name)
                operator.expect(operator.at(shown)).to_be_visible(timeout=60_000)
                stop_by_mouse(operator, page)
                operator.expect(operator.at(shown)).to_be_visible(timeout=60_000)
                page.locator(".q-dialog").get_by_role("button", name="Cancel").click()
                operator.expect(operator.at(shown)).to_have_count(0, timeout=60_000)
                release_stop(cell)
                operator.expect(operator.at("latched")).to_be_hidden(timeout=60_000)


def test_a_release_does_not_perform_what_came_meanwhile(address: list[str]) -> None:
    with client_of(address) as cell, console(*address) as (_, url), browser(url) as page:
        operator = Operator(page)
        ask(cell, "registration.plan_landmarks", landmarks())
        ask(cell, "toolplan.plan", tool_pose())
        ask(cell, "digitization.digitize_all", {})
        operator.shows("next", "Register")
        page.wait_for_timeout(SETTLED_MS)
        pointer_to(operator, "next")
        page.mouse.down()
        ask(cell, "registration.register", {})
        operator.shows("next", "Connect")
        page.wait_for_timeout(SETTLED_MS)
        page.mouse.up()
        page.wait_for_timeout(2_000)
        assert cell.state().branches["robot"] == "0"
        operator.press("next")
        operator.in_state("robot", "1")


def test_sliding_off_cancels_a_hold(address: list[str]) -> None:
    with client_of(address) as cell:
        to_registered_head(cell)
        with console(*address) as (_, url), browser(url) as page:
            operator = Operator(page)
            operator.shows("next", "Approach")
            page.wait_for_timeout(SETTLED_MS)
            pointer_to(operator, "next")
            page.mouse.down()
            page.mouse.move(700.0, 600.0)
            page.wait_for_timeout(HOLD_MS + 1_000)
            page.mouse.up()
            assert cell.state().branches["placement"] == "retracted"
            assert cell.state().running == []


def test_a_hold_from_before_a_pause_of_the_console_is_void(address: list[str]) -> None:
    with client_of(address) as cell:
        to_registered_head(cell)
        with console(*address) as (process, url), browser(url) as page:
            operator = Operator(page)
            operator.shows("next", "Approach")
            page.wait_for_timeout(SETTLED_MS)
            process.send_signal(signal.SIGSTOP)
            page.wait_for_timeout(1_000)
            operator.at("next").click(delay=HOLD_MS)
            page.wait_for_timeout(3_000)
            process.send_signal(signal.SIGCONT)
            page.wait_for_timeout(3_000)
            assert cell.state().branches["placement"] == "retracted"
            assert cell.state().running == []
            operator.press("next")
            operator.shows("running", "Approach")
