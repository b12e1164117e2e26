"""The page: Stop is always at hand, the user and a silent daemon are named, and a replay commands nothing."""

from __future__ import annotations

import inspect
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace
from nicegui import ui

from pcmrs.console._meaning import SETTLING_TIME
from pcmrs.console._page import Page
from pcmrs.console._surfaces import Surfaces
from pcmrs.messages import BlueprintTag, Running, Snapshot
from pcmrs.messages._snapshot import LeaseState
from pcmrs.messages.setup import ProcedureDataView
from pcmrs.testing.clock import settle
from pcmrs.workflows.data import as_message, as_transform
from tests.support.shipped import shipped_blueprint
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import body, setup, some_pose

BLUEPRINT = shipped_blueprint("ratms")
START = Snapshot(
    sequence=1, branches={name: next(iter(branch.states)) for name, branch in BLUEPRINT.branches.items()}, flags={},
    running=[], latched=False, blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)  # fmt: skip


class Cell(ShownCell):
    """A feed whose client only counts Stops, and keeps what is asked of the lease."""

    trouble = ""

    def __init__(self) -> None:
        super().__init__()
        self.stops = 0
        self.leases: list[str] = []
        self.client: Any = self
        self.history = SimpleNamespace(whole=True, entries=[])
        self.snapshot = START
        self.version = 1

    async def stop(self) -> None:
        self.stops += 1

    async def hold(self, operation: str) -> None:
        self.leases.append(operation)


class Playback(ShownCell):
    """A recording."""

    trouble = ""
    position = 0.0
    recorded = SimpleNamespace(started_at=1.7e9, duration=10.0)

    def __init__(self) -> None:
        super().__init__()
        self.snapshot = START
        self.version = 1


async def opened(page: DetachedPage, cell: Cell, playback: Any = None, **known_of_cell: Any) -> None:
    recordings: Any = SimpleNamespace(names=list)
    feed: Any = cell
    known = replace(setup(), user="anna", drivers={"robot": "sim"}, **known_of_cell)
    with page.client:
        Page(feed, known, BLUEPRINT, ENGLISH, Surfaces(feed), recordings, playback and ("run", playback))
    await page.tick()


def has(page: DetachedPage, name: str) -> bool:
    return any(each.props.get("data-testid") == name for each in page.client.elements.values())


async def key(page: DetachedPage, name: str) -> None:
    """Presses a key anywhere on the page."""
    event: Any = SimpleNamespace(action=SimpleNamespace(keydown=True), key=SimpleNamespace(name=name))
    with page.client:
        for keyboard in [each for each in page.client.elements.values() if isinstance(each, ui.keyboard)]:
            handlers: list[Any] = [*keyboard._key_handlers]
            for handler in handlers:
                if inspect.isawaitable(result := handler(event)):
                    await result
    await settle()


@pytest.mark.parametrize("replays", [False, True])
async def test_stop_is_sent_by_button_and_key_also_during_a_replay(page: DetachedPage, replays: bool) -> None:
    cell = Cell()
    await opened(page, cell, Playback() if replays else None)
    await page.press("stop")
    await key(page, "Escape")
    assert cell.stops == 2


async def test_escape_closes_a_dialog_unless_something_is_at_stake(page: DetachedPage) -> None:
    cell = Cell()
    cell.snapshot = planned = replace(START, branches=START.branches | {"registration": "100"})
    await opened(page, cell)
    cell.now = SETTLING_TIME
    await page.press_around("digitization.reuse_previous_except")
    assert page.at("which-landmark")
    await key(page, "Escape")
    await settle()
    assert (cell.stops, has(page, "which-landmark")) == (0, False)
    await key(page, "Escape")
    assert cell.stops == 1, "no dialog is open"
    await page.press_around("digitization.reuse_previous_except")
    cell.snapshot = replace(planned, running=[Running(branch="placement", operation="home", id="1")])
    await key(page, "Escape")
    assert (cell.stops, has(page, "which-landmark")) == (2, True)


async def test_escape_is_stop_in_a_dialog_without_the_daemon(page: DetachedPage) -> None:
    """The last state is old: the arm may move by now."""
    cell = Cell()
    cell.snapshot = replace(START, branches=START.branches | {"registration": "100"})
    await opened(page, cell)
    cell.now = SETTLING_TIME
    await page.press_around("digitization.reuse_previous_except")
    cell.client, cell.trouble = None, "The cable is cut."
    await key(page, "Escape")
    assert has(page, "which-landmark")
    assert page.notified == [ENGLISH("unreachable", why="The cable is cut.")]


async def test_the_next_step_is_on_the_page_whatever_tab_is_open(page: DetachedPage) -> None:
    cell = Cell()
    await opened(page, cell)
    assert page.text("next") == "Plan landmarks"
    cell.now = SETTLING_TIME
    await page.press_around("next")
    tabs = next(
        each for each in page.client.elements.values() if isinstance(each, ui.tabs) and each.value == "planning"
    )
    assert tabs.value == "planning"
    assert page.at("mode").value == "landmarks"


async def test_it_says_who_one_is_and_that_the_cell_is_simulated(page: DetachedPage) -> None:
    await opened(page, Cell())
    assert ENGLISH("signed_in", user="anna", role="operator") in page.text("signed-in")
    assert ENGLISH("simulated") in page.text("signed-in")
    assert not page.at("trouble").visible


@pytest.mark.parametrize("segments", [False, True])
async def test_page_names_the_cost_of_an_arm_in_segments(page: DetachedPage, segments: bool) -> None:
    await opened(page, Cell(), point_to_point=segments)
    names = {each.props.get("data-testid") for each in page.client.elements.values()}
    assert ("point-to-point" in names) == segments
    if segments:
        assert "0.5 s" in page.text("point-to-point")


async def test_without_daemon_the_reason_is_on_top_of_the_page(page: DetachedPage) -> None:
    cell = Cell()
    cell.client, cell.trouble = None, "The cable is cut."
    await opened(page, cell)
    assert "The cable is cut." in page.text("trouble")
    assert not any(page.at(f"robot.{name}").enabled for name in ("connect", "disconnect"))


async def test_the_lease_is_taken_taken_over_or_released(page: DetachedPage) -> None:
    cell = Cell()
    await opened(page, cell)
    for holder, operation in ((None, "acquire"), ("ben", "take_over"), ("anna", "release")):
        lease = None if holder is None else LeaseState(holder=holder)
        cell.snapshot, cell.version = replace(START, lease=lease), cell.version + 1
        await page.tick()
        assert page.text("lease") == (ENGLISH("nobody_holds") if holder is None else ENGLISH("holds", user=holder))
        await page.press("hold")
        assert cell.leases[-1] == operation


async def test_a_replay_is_shown_but_nothing_of_it_can_be_asked_for(page: DetachedPage) -> None:
    cell = Cell()
    await opened(page, cell, Playback())
    assert not page.at("hold").visible
    assert not page.at("robot.connect").enabled
    names = {each.props.get("data-testid") for each in page.client.elements.values()}
    assert {"tab-workflow", "tab-session", "replay"} <= names
    assert "tab-planning" not in names


async def test_the_error_of_the_tool_is_in_mm_and_degrees_or_unknown(page: DetachedPage) -> None:
    cell = Cell()
    await opened(page, cell)
    assert page.text("error") == ENGLISH("unknown")
    registered, plan, tracker_from_body = some_pose(1), some_pose(2), some_pose(3)
    cell.data = ProcedureDataView(landmarks=[], body_ref_from_image=as_message(registered), plan=as_message(plan))
    marker_from_tip = as_transform(setup().tool_marker_from_tool_tip)
    cell.poses = {
        "coil": body("coil", tracker_from_body @ registered @ plan @ marker_from_tip.inverse()),
        "body_ref": body("body_ref", tracker_from_body),
    }
    await page.tick()
    assert page.text("error").split() == ["0.00", "mm", "0.00°"]
