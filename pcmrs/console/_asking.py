"""Asker: the daemon for an operation: at once, or after a dialog for what only the person knows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nicegui import ui

from pcmrs.console._action_button import PageActions
from pcmrs.console._arguments_dialog import ArgumentsDialog
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._choices import Choice
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._next import LANDMARK, landmark_prompt, open_landmark
from pcmrs.messages.setup import Setup

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
        dialog = ArgumentsDialog(choice, wanted, {**stop, **known}, self._sender, self._actions)
        await self._actions.dialogs.ask(dialog.dialog)

    async def _landmark(self, choice: Choice) -> None:
        """Ask which landmark is meant, by its name, and then for the operation."""
        data, texts = self._view.data, self._actions.texts
        names = {index: landmark_prompt(data, index, texts) for index in range(len(data.landmarks))}
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(choice.title).classes("text-weight-bold")
            chosen = ui.select(names, label=texts("which_landmark"), value=open_landmark(data)).classes("w-full")
            chosen.props('data-testid="which-landmark"')
            with ui.row():
                send = ui.button(texts("send"), on_click=lambda: dialog.submit(chosen.value))
                send.props('data-testid="send-form"').bind_enabled_from(
                    chosen, "value", lambda value: value is not None
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
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(verdict.reason.text)
            with ui.row():
                ui.button(texts("looked"), on_click=lambda: dialog.submit(True)).props('data-testid="looked"')
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        if await self._actions.dialogs.ask(dialog):
            await self._sender.ask(choice.name, {"confirm": True})
