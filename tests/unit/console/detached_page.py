"""A page that no browser has opened: what its panels show, and what happens when something on it is pressed."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Iterator
from typing import Any

import pytest
from nicegui import Client, core, ui
from nicegui.element import Element
from nicegui.elements.scene.scene_object3d import Object3D
from nicegui.events import GenericEventArguments, handle_event
from nicegui.page import page as declare_page

from pcmrs.console._action_button import PageActions
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._dialogs import Dialogs
from pcmrs.console._meaning import SETTLING_TIME
from pcmrs.console._press import beat_of
from pcmrs.console.settings import MotionConsent
from pcmrs.console.texts import Texts
from pcmrs.testing.clock import settle

ENGLISH = Texts("en")


class ShownCell(CellViewModel):
    """What is known at a moment that the test chooses."""

    now = 0.0


class Hands:
    """A person at one page: how time passes, and what the buttons of the page share."""

    def __init__(self, consent: MotionConsent = "hold") -> None:
        self.now = 0.0
        self.actions = PageActions(ENGLISH, Dialogs(), lambda: self.now, consent)

    def look(self) -> None:
        """Lets so much time pass that buttons have settled."""
        self.now += SETTLING_TIME + 0.01


class DetachedPage:
    """The elements of one page; its timers run only when the test says so."""

    def __init__(self) -> None:
        self.client = Client(declare_page("/"))

    def at(self, name: str) -> Any:
        """The only element with this ``data-testid``."""
        (found,) = [each for each in self.client.elements.values() if each.props.get("data-testid") == name]
        return found

    def text(self, name: str) -> str:
        """The texts in the element with this ``data-testid``, line by line."""
        return "\n".join(_texts(self.at(name)))

    @property
    def everything(self) -> list[str]:
        """All texts of the page."""
        return list(_texts(self.client.content))

    def says(self, text: str) -> bool:
        """Whether any element has this text, in a dialog too."""
        return any(getattr(each, "text", "") == text for each in self.client.elements.values())

    @property
    def notified(self) -> list[str]:
        """All notifications so far."""
        return [str(data["message"]) for _, kind, data in self.client.outbox.messages if kind == "notify"]

    def only(self, kind: type[Any]) -> Any:
        """The only element of this kind."""
        (found,) = [each for each in self.client.elements.values() if isinstance(each, kind)]
        return found

    def shapes(self) -> dict[str, list[Object3D]]:
        """The shapes with a name in the only scene."""
        found: dict[str, list[Object3D]] = {}
        for each in self.only(ui.scene).objects.values():
            if each.name:
                found.setdefault(each.name, []).append(each)
        return found

    async def press(self, name: str) -> None:
        """Clicks on the element with this ``data-testid``, and waits for what follows."""
        await self._click(self.at(name))

    async def press_around(self, name: str, meaning: str | None = None, *, age: float = 0.0) -> None:
        """Clicks on what is around the element: it gets the click although the element is disabled.

        Args:
            name: Its ``data-testid``.
            meaning: What the button meant when it was pressed; what it means now by default.
            age: Age of the report, s.
        """
        await self._press(name, "click", meaning, age)

    async def hold(self, name: str, meaning: str | None = None, *, age: float = 0.0) -> None:
        """Presses and holds a button, as the browser reports it: with what it meant when it was pressed."""
        if meaning is not None or "data-hold" in self.at(name).props:
            await self._press(name, "held", meaning, age)

    async def _press(self, name: str, kind: str, meaning: str | None, age: float) -> None:
        button = self.at(name)
        around = button.parent_slot.parent
        handler: Any = next(each.handler for each in around._event_listeners.values() if each.type == kind)
        beat = beat_of(handler.__self__._actions.now() - age)
        press = {"meaning": button.props["data-meaning"] if meaning is None else meaning, "beat": beat}
        await self.happen(around, kind, {"detail": press} if kind == "held" else press)

    async def _click(self, element: Element) -> None:
        await self.happen(element, "click", [])

    async def happen(self, element: Element, kind: str, *reports: Any) -> None:
        """Let events of one kind arrive at an element, one directly after another, and wait for what follows.

        Args:
            element: The element.
            kind: Kind of the events.
            reports: What the browser reports for each.
        """
        core.loop = asyncio.get_running_loop()
        for args in reports:
            for listener in [each for each in element._event_listeners.values() if each.type == kind]:
                handle_event(listener.handler, GenericEventArguments(sender=element, client=self.client, args=args))
        await settle()

    async def tick(self) -> None:
        """Lets every timer run once."""
        core.loop = asyncio.get_running_loop()
        for timer in [each for each in self.client.elements.values() if isinstance(each, ui.timer)]:
            if timer.callback is not None and inspect.isawaitable(result := timer.callback()):
                await result


def _texts(element: Element) -> Iterator[str]:
    if not element.visible:
        return
    text = getattr(element, "text", "")
    if text:
        yield str(text)
    for child in element:
        yield from _texts(child)


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Iterator[DetachedPage]:
    """A page to put panels on, for the length of a test."""
    monkeypatch.setattr(ui.timer, "_skip_registration", lambda _: True)
    monkeypatch.setattr(core, "loop", None)
    opened = DetachedPage()
    with opened.client:
        yield opened
    opened.client.delete()
