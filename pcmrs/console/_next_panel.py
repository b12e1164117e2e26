"""The procedure leads: the next step as one large button, the stages, what runs, and the newest Stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nicegui import ui

from pcmrs.console._action_button import ActionButton, ButtonState, PageActions
from pcmrs.console._asking import Asking
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._choices import Choice
from pcmrs.console._next import NextButton, next_button
from pcmrs.console._progress import RemainingTime
from pcmrs.console._stop_report import StopReport, stop_report
from pcmrs.console.planning.panel import NAMES
from pcmrs.dispatcher.next_step import next_step
from pcmrs.fsm import Blueprint, guide_for
from pcmrs.messages import NextStep, Running, Snapshot

LOOK = "no-caps unelevated size=lg"
"""Quasar properties of the large button."""


class NextPanel:
    """Large button with its reason, above everything else on its half of the page.

    Args:
        view: State of the cell to show.
        blueprint: Workflow of the cell.
        actions: Shared parts of the page.
        asking: Asks for operations.
        plan: Opens the planning of an operation.
    """

    def __init__(
        self,
        view: CellViewModel,
        blueprint: Blueprint,
        actions: PageActions,
        asking: Asking,
        plan: Callable[[str], None],
    ) -> None:
        self._view, self._blueprint, self._texts = view, blueprint, actions.texts
        self._asking, self._plan = asking, plan
        self._guide = guide_for(blueprint)
        self._remaining = RemainingTime(actions.now)
        self._choices: Mapping[str, Choice] = {}
        self._shown = NextButton("none", "", "", "")
        self._drawn: tuple[StopReport | None, list[tuple[str, bool, bool]]] = (None, [])
        with ui.column().classes("w-full gap-1 q-pa-xs").props('data-testid="next-panel"'):
            self._stages = ui.row().classes("gap-1 items-center").props('data-testid="stages"')
            self._stop = ui.card().classes("w-full q-pa-sm gap-1 bg-red-1").props("flat bordered")
            self._stop.props('data-testid="stop-report"')
            with ui.row().classes("items-center w-full gap-3"):
                self._button = ActionButton("next", actions, self._act, LOOK)
                self._why = ui.label().classes("text-body2").props('data-testid="next-why"')
            with ui.row().classes("items-center w-full no-wrap"):
                self._spinner = ui.spinner(size="sm")
                self._running = ui.label().classes("text-weight-medium").props('data-testid="running"')
            self._progress = ui.linear_progress(show_value=False).props("instant-feedback")

    def refresh(self, shown: Snapshot, choices: Mapping[str, Choice]) -> None:
        """Show the next step from the present state.

        Args:
            shown: The present snapshot.
            choices: Operations by name.
        """
        self._choices = choices
        stop = shown.stop.number if shown.latched else None
        found = next_step(self._guide, shown.branches, stop=stop)
        self._shown = button = next_button(found, shown, choices, self._view.data, NAMES, self._texts)
        self._button.refresh(
            ButtonState(button.label, button.meaning, why_not=button.why, help=button.why, moves=button.moves)
        )
        self._why.set_text(button.why)
        self._draw(found, stop_report(shown, self._view.events, self._blueprint))
        running = shown.running[0] if shown.running else None
        self._spinner.set_visibility(running is not None)
        self._progress.set_visibility(running is not None)
        self._progress.set_value(0.0 if running is None else running.progress)
        self._running.set_text(self._texts("nothing_runs") if running is None else self._in_words(running))

    def _in_words(self, running: Running) -> str:
        name = f"{running.branch}.{running.operation}"
        choice, left = self._choices.get(name), self._remaining.of(running)
        title = name if choice is None else choice.title
        text = self._texts("progress", name=title, percent=100.0 * running.progress)
        return text if left is None else f"{text}, {self._texts('remaining', seconds=left)}"

    def _draw(self, found: NextStep, report: StopReport | None) -> None:
        """Draw stages and Stop again if they have changed."""
        stages = [(each.title, each.reached, each.id == found.stage) for each in found.stages]
        if (report, stages) == self._drawn:
            return
        self._drawn = (report, stages)
        self._stages.clear()
        with self._stages:
            for title, reached, is_next in stages:
                icon = "check_circle" if reached else "radio_button_checked" if is_next else "radio_button_unchecked"
                look = "text-weight-bold" if is_next else "text-grey-8"
                with ui.row().classes(f"items-center gap-1 no-wrap text-caption {look}"):
                    ui.icon(icon, color="green-8" if reached else "primary" if is_next else "grey-6")
                    ui.label(title)
        self._stop.set_visibility(report is not None)
        self._stop.clear()
        if report is not None:
            with self._stop:
                self._draw_stop(report)

    def _draw_stop(self, report: StopReport) -> None:
        texts = self._texts
        by = report.by or texts("unknown")
        ui.label(texts("stop_by", stop=report.number, by=by)).classes("text-weight-bold")
        if report.why:
            ui.label(report.why)
        if report.stopped:
            titles = (self._choices[name].title if name in self._choices else name for name in report.stopped)
            ui.label(texts("stop_ended", names=", ".join(titles)))
        for check in report.checks:
            ui.label(f"• {texts(check)}")

    async def _act(self) -> None:
        button = self._shown
        if button.press == "plan":
            self._plan(button.name)
        elif button.press == "ask":
            await self._asking.ask(self._choices[button.name], button.arguments)
