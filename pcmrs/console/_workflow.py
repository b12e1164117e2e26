"""Everything that may be asked for besides the next step: operations by branch, and refusals with their reasons."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from nicegui import ui

from pcmrs.console._action_button import ActionButton, ButtonState, PageActions
from pcmrs.console._asking import Asking
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._choices import Choice
from pcmrs.console._history import heading, why
from pcmrs.console._residuals import ResidualsView
from pcmrs.fsm import Blueprint
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs.messages.setup import Setup

REFUSED = 4
"""Number of the last refusals that are shown."""
LOOK = "dense no-caps size=sm"
"""Quasar properties of the buttons."""


class WorkflowPanel:
    """Residuals, refusals, and under "More" a button for each operation.

    Args:
        view: State of the cell to show.
        setup: Setup of the cell.
        blueprint: Workflow of the cell.
        actions: Shared parts of the page.
        asking: Asks for operations.
    """

    def __init__(
        self, view: CellViewModel, setup: Setup, blueprint: Blueprint, actions: PageActions, asking: Asking
    ) -> None:
        self._view, self._setup, self._blueprint, self._texts = view, setup, blueprint, actions.texts
        self._actions, self._asking = actions, asking
        self._choices: Mapping[str, Choice] = {}
        self._buttons: dict[str, ActionButton] = {}
        self._states: dict[str, ui.label] = {}
        self._residuals = ResidualsView(view, setup, actions.texts)
        self._unknown = ui.column().classes("w-full gap-0")
        ui.label(actions.texts("rejections")).classes("text-weight-bold q-mt-sm")
        self._refused = ui.column().classes("w-full gap-1").props('data-testid="refused"')
        with ui.expansion(actions.texts("more"), icon="tune").classes("w-full").props('data-testid="more"'):
            for name in blueprint.branches:
                self._add_branch(name)

    def _add_branch(self, name: str) -> None:
        branch = self._blueprint.branches[name]
        with ui.card().classes("w-full q-pa-sm gap-1").props("flat bordered"):
            with ui.row().classes("items-baseline w-full no-wrap"):
                ui.label(branch.title or name).classes("text-weight-bold")
                self._states[name] = ui.label().classes("text-grey-8").props(f'data-testid="state-{name}"')
            if name == "placement" and "confirm" in branch.operations:
                ends = self._texts("confirm_ends", mm=self._setup.confirm_offset * 1000.0)
                ui.label(ends).classes("text-grey-8").props('data-testid="confirm-offset"')
            with ui.row().classes("gap-1"):
                for operation, spec in branch.operations.items():
                    if not (spec.iio or spec.event):
                        full = f"{name}.{operation}"
                        self._buttons[full] = ActionButton(full, self._actions, partial(self._act, full), LOOK)

    def refresh(self, shown: Snapshot, choices: Mapping[str, Choice]) -> None:
        """Show the present state, and enable the possible operations.

        Args:
            shown: The present snapshot.
            choices: Operations by name.
        """
        self._choices = choices
        for branch, state in shown.branches.items():
            label = self._states[branch]
            label.set_text(self._blueprint.branches[branch].states[state])
            label.props(f'data-state="{state}"')
        for name, choice in choices.items():
            self._buttons[name].refresh(ButtonState(choice.title, choice.meaning, choice.why_not, name, choice.moves))
        self._residuals.refresh()
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

    def _is_bad(self, event: Verdict | DeviceEvent) -> bool:
        """Return true for a refused command of a person, or a danger of a device; activities belong to nobody."""
        if isinstance(event, DeviceEvent):
            return event.danger
        spec = self._blueprint.find(event.branch, event.operation)
        return event.decision != "accepted" and not (spec is not None and spec.event)

    async def _act(self, name: str) -> None:
        if name in self._choices:
            await self._asking.ask(self._choices[name], {})
