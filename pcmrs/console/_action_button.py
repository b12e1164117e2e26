"""A button that acts on the cell: never by a double click, and what moves the arm only when it is meant."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from nicegui import events, ui

from pcmrs.console._dialogs import Dialogs
from pcmrs.console._meaning import ButtonMeaning
from pcmrs.console._press import Press
from pcmrs.console.settings import MotionConsent
from pcmrs.console.texts import Texts

HOLD_SCRIPT = Path(__file__).with_name("hold.js")
"""Script of the browser that notes the meaning of a button at the press, and reports clicks and holds with it."""
_REPORT_CLICK = """
(event) => { const click = pcmrsPresses.click(event, event.currentTarget); if (click !== null) emit(click); }
"""
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
        confirms: A click is enough although it moves the robot: it is the answer to a question.
    """

    label: str
    meaning: str
    why_not: str = ""
    help: str = ""
    moves: bool = False
    confirms: bool = False


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
        around.on("click", self._clicked, js_handler=_REPORT_CLICK).on("held", self._held, args=["detail"])

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
        self._button.props["data-meaning"] = state.meaning
        if state.meaning and self._is_held:
            self._button.props["data-hold"] = "yes"
        else:
            self._button.props.pop("data-hold", None)
        self._button.update()

    @property
    def _is_held(self) -> bool:
        return self._state.moves and not self._state.confirms and self._actions.consent == "hold"

    def _help(self, state: ButtonState) -> str:
        if not state.moves or state.confirms:
            return state.help
        return f"{self._actions.texts('hold_help' if self._actions.consent == 'hold' else 'confirm_help')} {state.help}"

    async def _clicked(self, event: events.GenericEventArguments) -> None:
        state = self._state
        if not state.meaning:
            if state.why_not:
                warn(state.why_not)
            return
        if self._is_held or not self._counts(Press.of(event.args)):
            return
        if not state.moves or state.confirms or await self._confirmed(state):
            await self._act()

    async def _held(self, event: events.GenericEventArguments) -> None:
        if self._is_held and self._counts(Press.of(event.args.get("detail"))):
            await self._act()

    def _counts(self, press: Press) -> bool:
        """Return true if the button means now what it meant at the press, and the report of it is not late."""
        if press.meaning != self._state.meaning or not self._meaning.accepts(press.meaning):
            return False
        if press.is_late(self._actions.now()):
            warn(self._actions.texts("late_press"))
            return False
        return True

    async def _confirmed(self, state: ButtonState) -> bool:
        """Ask whether a motion is meant; the answer counts only if the button still means the same."""
        texts = self._actions.texts
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(state.label).classes("text-weight-bold")
            ui.label(texts("moves_arm"))

            async def move() -> None:
                dialog.submit(True)

            with ui.row():
                button = ActionButton("move-now", self._actions, move, "no-caps")
                button.refresh(ButtonState(texts("move_now"), state.meaning, moves=True, confirms=True))
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        return bool(await self._actions.dialogs.ask(dialog)) and self._state.meaning == state.meaning


def warn(text: str) -> None:
    """Show a warning in the corner of the page."""
    ui.notify(text, type="warning", multi_line=True, position="bottom-left")
