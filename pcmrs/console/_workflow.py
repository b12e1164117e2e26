"""The workflow: possible operations, running ones, and refusals with their reasons."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import msgspec
from nicegui import ui

from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._choices import Choice
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._history import heading, why
from pcmrs.console._residuals import ResidualsView
from pcmrs.console.texts import Texts
from pcmrs.fsm import Blueprint
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs.messages.setup import Setup

REFUSED = 4
"""Number of the last refusals that are shown."""


class WorkflowPanel:
    """Buttons by branch, the running operation and the last refusals.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        blueprint: Workflow of the cell.
        texts: Texts in the language of the page.
        sender: Sends commands to the daemon.
    """

    def __init__(
        self, view: CellViewModel, setup: Setup, blueprint: Blueprint, texts: Texts, sender: CommandSender
    ) -> None:
        self._view, self._blueprint, self._texts, self._sender = view, blueprint, texts, sender
        self._choices: Mapping[str, Choice] = {}
        self._buttons: dict[str, tuple[ui.button, ui.tooltip]] = {}
        self._states: dict[str, ui.label] = {}
        with ui.row().classes("items-center w-full no-wrap"):
            self._spinner = ui.spinner(size="sm")
            self._running = ui.label().classes("text-weight-medium").props('data-testid="running"')
        self._progress = ui.linear_progress(show_value=False).props("instant-feedback")
        self._prompt = ui.label().classes("text-h6 text-primary").props('data-testid="prompt"')
        self._residuals = ResidualsView(view, setup, texts)
        self._unknown = ui.column().classes("w-full gap-0")
        for name, branch in blueprint.branches.items():
            with ui.card().classes("w-full q-pa-sm gap-1").props("flat bordered"):
                with ui.row().classes("items-baseline w-full no-wrap"):
                    ui.label(branch.title or name).classes("text-weight-bold")
                    self._states[name] = ui.label().classes("text-grey-8").props(f'data-testid="state-{name}"')
                with ui.row().classes("gap-1"):
                    self._add_buttons(name)
                if "confirm" in branch.operations and name == "placement":
                    ends = texts("confirm_ends", mm=setup.confirm_offset * 1000.0)
                    ui.label(ends).classes("text-grey-8").props('data-testid="confirm-offset"')
        ui.label(texts("rejections")).classes("text-weight-bold q-mt-sm")
        self._refused = ui.column().classes("w-full gap-1").props('data-testid="refused"')

    def _add_buttons(self, branch: str) -> None:
        for operation, spec in self._blueprint.branches[branch].operations.items():
            if spec.iio or spec.event:
                continue
            name = f"{branch}.{operation}"
            with ui.element("div").classes("asking").on("click", partial(self._press, name), args=[]):
                button = ui.button(spec.title or operation.replace("_", " ")).props("dense no-caps size=sm")
                button.props(f'data-testid="{name}"')
                button.props(f"color={'primary' if spec.moves else 'blue-grey-7'}")
                tooltip = ui.tooltip()
            self._buttons[name] = (button, tooltip)

    def refresh(self, shown: Snapshot, choices: Mapping[str, Choice]) -> None:
        """Show the present state, and enable the possible operations.

        Args:
            shown: The present snapshot.
            choices: Operations by name.
        """
        self._choices = choices
        for branch, state in shown.branches.items():
            meaning = self._blueprint.branches[branch].states[state]
            self._states[branch].set_text(f"{state}: {meaning}")
        for name, choice in choices.items():
            button, tooltip = self._buttons[name]
            button.set_enabled(not choice.why_not)
            tooltip.set_text(choice.why_not or name)
        self._residuals.refresh()
        running = shown.running[0] if shown.running else None
        self._spinner.set_visibility(running is not None)
        self._progress.set_visibility(running is not None)
        self._progress.set_value(0.0 if running is None else running.progress)
        if running is None:
            self._running.set_text(self._texts("nothing_runs"))
        else:
            self._running.set_text(self._texts("running", name=f"{running.branch}.{running.operation}"))
        prompt = None if running is None else running.prompt
        self._prompt.set_visibility(prompt is not None)
        self._prompt.set_text("" if prompt is None else prompt.text)
        self._unknown.clear()
        with self._unknown:
            for each in shown.unknown:
                ui.label(f"{self._texts('unsettled')}: {each.branch}.{each.operation}").classes("text-orange-9")
        self._show_refused()

    def _show_refused(self) -> None:
        self._refused.clear()
        bad = [event for _, event in self._view.events if self._is_bad(event)][-REFUSED:]
        with self._refused:
            for event in reversed(bad):
                with ui.card().classes("w-full q-pa-xs gap-0 bg-orange-1").props("flat bordered"):
                    ui.label(heading(event)).classes("text-weight-medium")
                    ui.label(why(event)).classes("text-body2")
                    if isinstance(event, Verdict) and event.allowed:
                        ui.label(self._texts("allowed", names=", ".join(event.allowed))).classes("text-grey-8")

    def _is_bad(self, event: Verdict | DeviceEvent) -> bool:
        """Return true for a refused command of a person, or a danger of a device; activities belong to nobody."""
        if isinstance(event, DeviceEvent):
            return event.danger
        spec = self._blueprint.find(event.branch, event.operation)
        return event.decision != "accepted" and not (spec is not None and spec.event)

    async def _press(self, name: str) -> None:
        choice = self._choices.get(name)
        if choice is None:
            return
        if choice.why_not:
            ui.notify(choice.why_not, type="warning", multi_line=True, position="bottom-left")
            return
        if choice.payload == "none":
            await self._sender.ask(name, {"stop": choice.stop} if choice.stop is not None else {})
            return
        if choice.payload == "retreat":
            await self._request_retreat(name)
            return
        arguments = await self._arguments(choice)
        if arguments is not None:
            await self._sender.ask(name, arguments)

    async def _request_retreat(self, name: str) -> None:
        """Send a retreat. If the way must be checked first, ask the person whether it is clear."""
        verdict, texts = await self._sender.ask(name, {}), self._texts
        if verdict is None or verdict.reason is None or verdict.reason.code != "body_not_registered":
            return
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(verdict.reason.text)
            with ui.row():
                ui.button(texts("looked"), on_click=lambda: dialog.submit(True)).props('data-testid="looked"')
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(False)).props("flat")
        try:
            if await dialog:
                await self._sender.ask(name, {"confirm": True})
        finally:
            dialog.delete()

    async def _arguments(self, choice: Choice) -> dict[str, Any] | None:
        """Ask the person for the arguments, as JSON; None if they cancel."""
        texts = self._texts
        with ui.dialog() as dialog, ui.card().classes("w-96"):
            ui.label(f"{choice.title} ({choice.payload})").classes("text-weight-bold")
            given = ui.textarea(texts("arguments"), value=EXAMPLES.get(choice.payload, "{}")).classes("w-full")
            given.props('data-testid="arguments"')
            with ui.row():
                ui.button(texts("ask"), on_click=lambda: dialog.submit(given.value)).props('data-testid="ask"')
                ui.button(texts("cancel"), on_click=lambda: dialog.submit(None)).props("flat")
        try:
            text = await dialog
            if text is None:
                return None
            return msgspec.json.decode(text, type=dict[str, Any])
        except msgspec.DecodeError as error:
            ui.notify(texts("invalid", why=error), type="negative")
            return None
        finally:
            dialog.delete()


EXAMPLES = {"landmark_index": '{"index": 0}', "landmark_names": '{"names": ["nasion"]}'}
