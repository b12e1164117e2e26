"""The next step is one large button; stages, what runs and the newest Stop are beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from msgspec.structs import replace

from pcmrs.console._asking import Asking
from pcmrs.console._choices import Choices
from pcmrs.console._next_panel import NextPanel
from pcmrs.messages import DeviceEvent, Running, Snapshot, StopState, Verdict
from tests.unit.console.detached_page import ENGLISH, DetachedPage, Hands, ShownCell
from tests.unit.console.shown_cell import setup
from tests.unit.console.test_next import BLUEPRINT, REGISTERED, data, shown

CHOICES = Choices(BLUEPRINT, ENGLISH)


class Sender:
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Mapping[str, Any]]] = []

    async def ask(self, name: str, arguments: Mapping[str, Any]) -> Verdict | None:
        self.sent.append((name, arguments))
        return None


class Shown:
    """The panel on a page, with what was sent and planned."""

    def __init__(self, page: DetachedPage, touched: int = 0) -> None:
        self.view, self.hands, self.sender = ShownCell(), Hands(), Sender()
        self.view.data = data(touched)
        self.planned: list[str] = []
        sender: Any = self.sender
        with page.client:
            asking = Asking(self.view, setup(), sender, self.hands.actions)
            self.panel = NextPanel(self.view, BLUEPRINT, self.hands.actions, asking, self.planned.append)

    def see(self, snapshot: Snapshot) -> None:
        self.panel.refresh(snapshot, CHOICES.all(snapshot, setup()))


async def test_pressing_next_opens_planning_or_asks(page: DetachedPage) -> None:
    it = Shown(page, touched=1)
    it.see(shown())
    it.hands.look()
    await page.press_around("next")
    assert (it.planned, it.sender.sent) == (["registration.plan_landmarks"], [])
    it.see(shown(registration="100", toolplan="1"))
    await page.press_around("next")
    assert it.sender.sent == [], "its meaning has just changed"
    it.hands.look()
    await page.press_around("next")
    assert it.sender.sent == [("digitization.digitize_one", {"index": 1})]
    assert page.text("next") == "Touch 2 of 6: left eye"


async def test_next_motion_is_held(page: DetachedPage) -> None:
    it = Shown(page)
    it.see(shown(**REGISTERED, robot="1", placement="retracted"))
    it.hands.look()
    await page.press_around("next")
    assert it.sender.sent == []
    await page.hold("next")
    assert it.sender.sent == [("placement.approach", {})]


def test_stages_and_progress_are_visible(page: DetachedPage) -> None:
    it = Shown(page)
    moving = shown(**REGISTERED, robot="1", placement="retracted")
    it.see(moving)
    assert page.text("stages").splitlines()[0] == "Plan the landmarks and the pose of the coil"
    assert page.text("running") == ENGLISH("nothing_runs")
    for progress, now in ((0.0, 0.0), (0.5, 4.0)):
        it.hands.now = now
        it.see(replace(moving, running=[Running(branch="placement", operation="approach", id="1", progress=progress)]))
    assert page.text("running") == "Approach: 50 %, about 4 s left"
    assert not page.at("next").enabled


async def test_a_stop_is_explained_and_released_by_its_number(page: DetachedPage) -> None:
    it = Shown(page)
    stopped = replace(
        shown(**REGISTERED, robot="1", placement="held"), latched=True, stop=StopState(number=7, confirmed=True)
    )
    it.see(shown(**REGISTERED))
    assert not page.at("stop-report").visible
    event = DeviceEvent(device="bus:anna", code="stopped", text="Stopped by bus:anna.", danger=True, fields={"stop": 7})
    it.view.events.append((0.0, event))
    it.see(stopped)
    lines = page.text("stop-report").splitlines()
    assert lines[:2] == ["Stop 7, by bus:anna", "Stopped by bus:anna."]
    assert f"• {ENGLISH('check_cause')}" in lines
    it.hands.look()
    await page.press_around("next")
    assert it.sender.sent == [("robot.acknowledge", {"stop": 7})]


async def test_a_newer_stop_is_not_released_by_a_press_for_another(page: DetachedPage) -> None:
    it = Shown(page)
    stopped = replace(shown(**REGISTERED, robot="1", placement="held"), latched=True, stop=StopState(number=7))
    it.see(stopped)
    it.hands.look()
    it.see(replace(stopped, stop=StopState(number=8)))
    await page.press_around("next")
    assert it.sender.sent == []


async def test_a_motion_to_another_plan_is_another_meaning(page: DetachedPage) -> None:
    it = Shown(page)
    ready = replace(shown(**REGISTERED, robot="1", placement="retracted"), plan="a", registration="r")
    it.see(ready)
    it.hands.look()
    held = page.at("next").props["data-meaning"]
    for changed in ({"plan": "b"}, {"registration": "s"}, {"stop": StopState(number=1)}):
        it.see(replace(ready, **changed))
        it.hands.look()
        await page.hold("next", held)
    assert it.sender.sent == []
    it.see(ready)
    it.hands.look()
    await page.hold("next", held)
    assert it.sender.sent == [("placement.approach", {})]
