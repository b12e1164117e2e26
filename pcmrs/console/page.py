"""The page: Stop above all, the cell to the left, what can be done to the right."""

from __future__ import annotations

from dataclasses import replace

from nicegui import events, ui

from pcmrs.console.asking import Asking
from pcmrs.console.choices import Choices
from pcmrs.console.feed import Feed
from pcmrs.console.geometry import placement
from pcmrs.console.planning.panel import PlanningPanel
from pcmrs.console.scene import ScenePanel
from pcmrs.console.signals import SignalsPanel
from pcmrs.console.texts import Texts, languages
from pcmrs.console.timeline import TimelinePanel
from pcmrs.console.workflow import WorkflowPanel
from pcmrs.fsm import Blueprint
from pcmrs.fsm.chart import svg
from pcmrs.messages.setup import Setup

REFRESHED = 0.1
"""Between two looks at what has changed, s."""


class Page:
    """One open browser page.

    Args:
        feed: What the cell tells.
        setup: Of the cell.
        blueprint: Its workflow.
        texts: Of the page's language.
    """

    def __init__(self, feed: Feed, setup: Setup, blueprint: Blueprint, texts: Texts) -> None:
        self._feed, self._setup, self._blueprint, self._texts = feed, setup, blueprint, texts
        self._asking, self._choices = Asking(feed, texts), Choices(blueprint)
        self._version = -1
        self._drawn: dict[str, str] = {}
        ui.keyboard(on_key=self._key, ignore=["input", "textarea"])
        self._header()
        with ui.splitter(value=56).classes("w-full").style("height: calc(100vh - 64px)") as halves:
            with halves.before, ui.column().classes("w-full h-full gap-0"):
                self._left()
            with halves.after, ui.column().classes("w-full gap-0 q-pa-xs"):
                self._right()
        ui.timer(REFRESHED, self._refresh)

    def _header(self) -> None:
        texts = self._texts
        ui.query(".nicegui-content").classes("p-0")
        ui.add_css(".state-chart svg { max-width: 100%; height: auto; }")
        with ui.header().classes("items-center q-py-none bg-blue-grey-10").style("height: 64px"):
            stop = ui.button(f"{texts('stop')} ({texts('stop_key')})", on_click=self._asking.stop, color="red-9")
            stop.props("size=md no-caps unelevated").classes("text-weight-bold").props('data-testid="stop"')
            self._latched = ui.badge(texts("latched"), color="red-9").props('data-testid="latched"')
            with ui.column().classes("gap-0"):
                ui.label(self._blueprint.title or self._blueprint.id).classes("text-weight-bold")
                signed = texts("signed_in", user=self._setup.user, role=self._setup.role)
                simulated = f", {texts('simulated')}" if "sim" in self._setup.drivers.values() else ""
                ui.label(f"{signed}{simulated}").classes("text-caption").props('data-testid="signed-in"')
            self._lease = ui.label().classes("text-caption").props('data-testid="lease"')
            self._holding = (
                ui.button(on_click=self._hold).props("flat dense no-caps color=white").props('data-testid="hold"')
            )
            ui.space()
            self._error = ui.label().classes("text-h6").props('data-testid="error"')
            ui.space()
            ui.label(texts("research")).classes("text-caption")
            ui.toggle(list(languages()), value=texts.language, on_change=_in_language).props("dense size=sm").props(
                'data-testid="language"'
            )
        self._trouble = ui.label().classes("w-full bg-red-2 q-pa-sm").props('data-testid="trouble"')

    def _left(self) -> None:
        texts = self._texts
        with ui.tabs().props("dense no-caps align=left") as tabs:
            ui.tab("scene", texts("scene"))
            ui.tab("chart", texts("chart"))
        with ui.tab_panels(tabs, value="scene", animated=False, keep_alive=True).classes("w-full col-grow"):
            with ui.tab_panel("scene").classes("p-0 h-full"):
                self._scene = ScenePanel(self._feed, self._setup)
            with ui.tab_panel("chart").classes("p-0"):
                self._chart = ui.html("", sanitize=False).classes("w-full state-chart").props('data-testid="chart"')

    def _right(self) -> None:
        texts, feed, setup = self._texts, self._feed, self._setup
        with ui.tabs().props("dense no-caps align=left") as tabs:
            for name in ("workflow", "planning", "signals", "session"):
                ui.tab(name, texts(name)).props(f'data-testid="tab-{name}"')
        with ui.tab_panels(tabs, value="workflow", animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("workflow").classes("p-1"):
                self._workflow = WorkflowPanel(feed, setup, self._blueprint, texts, self._asking)
            with ui.tab_panel("planning").classes("p-1"):
                self._planning = PlanningPanel(feed, setup, self._blueprint, texts, self._asking)
            with ui.tab_panel("signals").classes("p-1"):
                SignalsPanel(feed, texts)
            with ui.tab_panel("session").classes("p-1"):
                self._timeline = TimelinePanel(feed, setup, texts)

    def _refresh(self) -> None:
        feed, texts = self._feed, self._texts
        found = placement(feed.data, feed.poses.get("coil"), feed.poses.get("body_ref"))
        self._error.set_text("" if found is None else f"{found.mm[0]:.2f} mm   {found.degrees:.2f}°")
        if feed.version == self._version:
            return
        self._version = feed.version
        self._trouble.set_visibility(feed.client is None)
        self._trouble.set_text(texts("unreachable", why=feed.trouble))
        shown = feed.snapshot
        if shown is None:
            return
        self._latched.set_visibility(shown.latched)
        holder = None if shown.lease is None else shown.lease.holder
        self._lease.set_text(texts("nobody_holds") if holder is None else texts("holds", user=holder))
        self._holding.set_text(texts("release" if holder == self._setup.user else "take"))
        if shown.branches != self._drawn:
            self._drawn = dict(shown.branches)
            self._chart.set_content(svg(self._blueprint, shown.branches))
        choices = self._choices.all(shown, self._setup)
        if feed.client is None:
            choices = {name: replace(each, why_not=feed.trouble) for name, each in choices.items()}
        self._workflow.refresh(shown, choices)
        self._planning.refresh(choices)
        self._timeline.refresh()

    async def _hold(self) -> None:
        shown = self._feed.snapshot
        if shown is None:
            return
        holder = None if shown.lease is None else shown.lease.holder
        operation = "release" if holder == self._setup.user else "acquire" if holder is None else "take_over"
        await self._asking.hold(operation)

    async def _key(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        if event.key.name == "Escape":
            await self._asking.stop()
        else:
            self._planning.key(event.key.name)


def _in_language(event: events.ValueChangeEventArguments[str]) -> None:
    ui.navigate.to(f"/?language={event.value}")
