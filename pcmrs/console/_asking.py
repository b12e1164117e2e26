"""Asker: the daemon for an operation: at once, or after a dialog for what only the person knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from pcmrs.console._action_button import ActionButton, ButtonState, PageActions, warn
from pcmrs.console._arguments_dialog import ArgumentsDialog
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._choices import Choice, context_of
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._next import LANDMARK, landmark_prompt, open_landmark
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import ArgumentShown, Setup

RETREAT = "retreat"
"""Registered name of the arguments of a retreat, which a person may have to confirm."""


class Asking:
    """Sender of requests for operations on behalf of one page.

    Args:
        view: State of the cell, with the planned landmarks.
        setup: Setup of the cell, with the arguments of its operations.
        sender: Sends commands to the daemon.
        actions: Shared parts of the page.
    """

    def __init__(self, view: CellViewModel, setup: Setup, sender: CommandSender, actions: PageActions) -> None:
        self._view, self._setup, self._sender, self._actions = view, setup, sender, actions

    async def ask(self, choice: Choice, known: Mapping[str, Any]) -> None:
        """Ask for an operation.

        Args:
            choice: The operation.
            known: Arguments that are known already.
        """
        if choice.payload == RETREAT:
            await self._retreat(choice)
            return
        if choice.payload == LANDMARK and "index" not in known:
            await self._landmark(choice)
            return
        stop = {"stop": choice.stop} if choice.stop is not None else {}
        wanted = [each for each in self._setup.arguments.get(choice.payload, []) if each.name not in known]
        if not wanted:
            await self._sender.ask(choice.name, {**stop, **known})
            return
        await self._with_form(choice, wanted, {**stop, **known})

    async def _with_form(self, choice: Choice, wanted: Sequence[ArgumentShown], known: Mapping[str, Any]) -> None:
        """Ask for an operation after a form, which opens again with its input if the daemon refuses the arguments.

        If the outcome is not known, it does not: what was sent may have happened.
        """
        form = ArgumentsDialog(choice, wanted, self._actions)
        while (typed := await self._actions.dialogs.ask(form.dialog)) is not None:
            if choice.context and choice.context != context_of(self._view.snapshot):
                warn(self._actions.texts("changed"))
                return
            verdict = await self._sender.ask(choice.name, {**known, **typed})
            if verdict is None or verdict.reason is None or verdict.decision != "rejected":
                return
            form = ArgumentsDialog(choice, wanted, self._actions, form.typed, verdict.reason.text)

    async def _landmark(self, choice: Choice) -> None:
        """Ask which landmark is meant, by its name, and then for the operation."""
        data, texts = self._view.data, self._actions.texts
        names = {index: landmark_prompt(data, index, texts) for index in range(len(data.landmarks))}
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(choice.title).classes("text-weight-bold")
            chosen = ui.select(names, label=texts("which_landmark"), value=open_landmark(data)).classes("w-full")
            chosen.props('data-testid="which-landmark"')

            async def submit() -> None:
                dialog.submit(chosen.value)

            with ui.row():
                send = ActionButton("send-form", self._actions, submit, "")
                meaning = choice.name if chosen.value is not None else ""
                send.refresh(ButtonState(texts("send"), meaning, texts("field_needed")))
                chosen.on_value_change(
                    lambda: send.refresh(ButtonState(texts("send"), choice.name, texts("field_needed")))
                )
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        index = await self._actions.dialogs.ask(dialog)
        if index is not None:
            await self._sender.ask(choice.name, {"index": index})

    async def _retreat(self, choice: Choice) -> None:
        """Ask for a retreat. If the way must be checked first, ask the person whether it is clear."""
        verdict, texts = await self._sender.ask(choice.name, {}), self._actions.texts
        if verdict is None or verdict.reason is None or verdict.reason.code != "body_not_registered":
            return
        seen = _whereabouts(self._view.snapshot)
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(verdict.reason.text)

            async def submit() -> None:
                dialog.submit(True)

            with ui.row():
                looked = ActionButton("looked", self._actions, submit, "no-caps")
                held = self._actions.consent == "hold"
                looked.refresh(ButtonState(texts("looked"), choice.name, moves=True, confirms=not held))
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        if not await self._actions.dialogs.ask(dialog):
            return
        if seen is None or seen != _whereabouts(self._view.snapshot):
            warn(texts("changed"))
            return
        await self._sender.ask(choice.name, {"confirm": True})


def _whereabouts(shown: Snapshot | None) -> tuple[str, Mapping[str, str], bool] | None:
    """Return what a person has seen who looked at the path of a retreat; None if it is not known."""
    return None if shown is None else (context_of(shown), shown.branches, shown.latched)
