"""A button that acts on the cell: never by a double click, and what moves the arm only when it is meant."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nicegui import events, ui

from pcmrs.console._dialogs import Dialogs
from pcmrs.console._meaning import ButtonMeaning
from pcmrs.console.settings import MotionConsent
from pcmrs.console.texts import Texts

HOLD_SCRIPT = Path(__file__).with_name("hold.js")
"""Script of the browser that reports a button which was pressed and held."""
STYLE = """
.asking .q-btn[disabled] { pointer-events: none; }
.asking [data-hold] { touch-action: none; user-select: none; -webkit-touch-callout: none; }
.asking [data-hold]::after { content: ""; position: absolute; inset: 0 auto 0 0; width: 0; background: #ffffff66; }
.asking [data-hold].holding::after { width: 100%; transition: width 0.8s linear; }
"""


@dataclass(frozen=True, slots=True)
class PageActions:
    """Parts of one page that its buttons share.

    Attributes:
        texts: Texts in the language of the page.
        dialogs: Open dialogs of the page.
        now: Returns the present time, s of a steady clock.
        consent: How a person shows that a motion is meant.
    """

    texts: Texts
    dialogs: Dialogs
    now: Callable[[], float]
    consent: MotionConsent


@dataclass(frozen=True, slots=True)
class ButtonState:
    """Present state of a button.

    Attributes:
        label: Its text.
        meaning: Name of what a press does; empty if it does nothing.
        why_not: Reason why it does nothing.
        help: Explanation under the pointer if it does something.
        moves: It moves the robot.
    """

    label: str
    meaning: str
    why_not: str = ""
    help: str = ""
    moves: bool = False


class ActionButton:
    """One button; what is around it gets the click although the button is disabled, and says why.

    Args:
        name: Its ``data-testid``.
        actions: Shared parts of the page.
        act: Called when the button was pressed as its present meaning needs it.
        look: Quasar properties of the button.
    """

    def __init__(self, name: str, actions: PageActions, act: Callable[[], Awaitable[None]], look: str) -> None:
        self._actions, self._act = actions, act
        self._meaning = ButtonMeaning(actions.now)
        self._state = ButtonState("", "")
        with ui.element("div").classes("asking") as around:
            self._button = ui.button().props(look).props(f'data-testid="{name}"')
            self._tooltip = ui.tooltip()
        around.on("click", self._clicked, args=[]).on("held", self._held, args=["detail"])

    def refresh(self, state: ButtonState) -> None:
        """Show the present state."""
        if state == self._state:
            return
        self._state = state
        self._meaning.show(state.meaning)
        self._button.set_text(state.label)
        self._button.set_enabled(bool(state.meaning))
        self._tooltip.set_text(state.why_not or self._help(state))
        self._button.props(f"color={'deep-orange-9' if state.moves else 'blue-grey-7'}")
        if state.moves:
            self._button.props("icon=precision_manufacturing")
        else:
            self._button.props(remove="icon")
        if state.moves and state.meaning and self._actions.consent == "hold":
            self._button.props["data-hold"] = state.meaning
        else:
            self._button.props.pop("data-hold", None)
        self._button.update()

    def _help(self, state: ButtonState) -> str:
        if not state.moves:
            return state.help
        return f"{self._actions.texts('hold_help' if self._actions.consent == 'hold' else 'confirm_help')} {state.help}"

    async def _clicked(self) -> None:
        state = self._state
        if not state.meaning:
            if state.why_not:
                ui.notify(state.why_not, type="warning", multi_line=True, position="bottom-left")
            return
        if not self._meaning.accepts(state.meaning):
            return
        if not state.moves or (self._actions.consent == "confirm" and await self._confirmed(state)):
            await self._act()

    async def _held(self, event: events.GenericEventArguments) -> None:
        """Act if what was held is what the button means now."""
        held: Any = event.args.get("detail")
        if self._state.moves and self._actions.consent == "hold" and self._meaning.accepts(str(held)):
            await self._act()

    async def _confirmed(self, state: ButtonState) -> bool:
        """Ask whether a motion is meant; the answer counts only if the button still means the same."""
        texts, meaning = self._actions.texts, ButtonMeaning(self._actions.now)
        meaning.show(state.meaning)
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(state.label).classes("text-weight-bold")
            ui.label(texts("moves_arm"))

            def move() -> None:
                if meaning.accepts(state.meaning):
                    dialog.submit(True)

            with ui.row():
                ui.button(texts("move_now"), on_click=move, color="deep-orange-9").props('data-testid="move-now"')
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        return bool(await self._actions.dialogs.ask(dialog)) and self._state.meaning == state.meaning
