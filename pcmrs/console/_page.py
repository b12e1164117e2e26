"""The page: Stop on top, the cell on the left, the next step and all operations on the right."""

from __future__ import annotations

from dataclasses import replace

from nicegui import events, ui

from pcmrs.console._action_button import HOLD_SCRIPT, PageActions
from pcmrs.console._action_button import STYLE as BUTTON_STYLE
from pcmrs.console._asking import Asking
from pcmrs.console._cell import CellPanel
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._chart import ChartPanel
from pcmrs.console._choices import Choice, Choices, latch_of
from pcmrs.console._command_sender import CommandSender
from pcmrs.console._dialogs import Dialogs
from pcmrs.console._escape import EscapeKey
from pcmrs.console._geometry import placement_deviation, tool_tip
from pcmrs.console._live_feed import LiveFeed
from pcmrs.console._next_panel import NextPanel
from pcmrs.console._playback_bar import PlaybackBar, choose_recording
from pcmrs.console._press import BEAT_PERIOD, beat_of
from pcmrs.console._recordings import Recordings
from pcmrs.console._surfaces import Surfaces
from pcmrs.console._timeline import TimelinePanel
from pcmrs.console._workflow import WorkflowPanel
from pcmrs.console.planning.panel import PlanningPanel
from pcmrs.console.playback import Playback
from pcmrs.console.settings import MotionConsent
from pcmrs.console.signals.panel import SignalsPanel
from pcmrs.console.texts import Texts, languages
from pcmrs.fsm import Blueprint
from pcmrs.messages import Snapshot
from pcmrs.messages.setup import Setup

REFRESH_PERIOD = 0.1
"""Period of refreshing the page, s."""
STYLE = """
.state-chart svg { max-width: 100%; height: auto; }
.replay { background: repeating-linear-gradient(135deg, #ede7f6 0 18px, #d1c4e9 18px 36px); min-height: 52px; }
body { --head: 64px; touch-action: pan-x pan-y; }
.head { height: var(--head); overflow: hidden; align-content: center; z-index: 6500 !important; }
.head > * { flex-shrink: 0; white-space: nowrap; }
.head .caption { font-size: 12px; line-height: 1.1; }
.head .figure { font-size: 34px; line-height: 40px; }
.nicegui-content { height: calc(100dvh - var(--head)); flex-wrap: nowrap; overflow: hidden; }
.halves { flex: 1 1 0; min-height: 0; }
.left-panels { flex: 1 1 0; min-height: 0; }
.left-panels .q-tab-panel { height: 100%; overflow: auto; }
@media (max-width: 1199.98px) { .head .figure { font-size: 24px; line-height: 32px; } }
@media (max-width: 1023.98px) { body { --head: 112px; } .head { flex-wrap: wrap; } }
@media (pointer: coarse) {
  .q-btn, .q-tab, .q-checkbox, .q-field .q-field__control, .q-item { min-height: 44px; min-width: 44px; }
  .halves > .q-splitter__separator { min-width: 12px; min-height: 12px; }
  .halves > .q-splitter__separator > div { inset: 0; }
}
"""
"""Two fingers do not zoom the page: that would move Stop out of sight. A narrow page has two rows in its head.

The head is above dialogs and menus, which Quasar puts at 6000: none of them may cover Stop.
"""
IS_NARROW = "Quasar.Screen.lt.md"
"""The browser reports a width below 1024 pixels. An upright tablet has the halves one above the other."""


class Page:
    """One open browser page.

    Args:
        feed: State of the cell.
        setup: Setup of the cell.
        blueprint: Workflow of the cell.
        texts: Texts in the language of the page.
        surfaces: Served surfaces of the body.
        recordings: Recordings to choose from.
        playback: Name and playback of a recording to show instead of the cell; then only Stop is sent.
        consent: How a person shows that a motion is meant.
    """

    def __init__(
        self,
        feed: LiveFeed,
        setup: Setup,
        blueprint: Blueprint,
        texts: Texts,
        surfaces: Surfaces,
        recordings: Recordings,
        playback: tuple[str, Playback] | None = None,
        consent: MotionConsent = "hold",
    ) -> None:
        self._feed, self._setup, self._blueprint, self._texts = feed, setup, blueprint, texts
        self._view: CellViewModel = feed if playback is None else playback[1]
        self._sender, self._choices = CommandSender(feed, texts), Choices(blueprint, texts)
        self._dialogs, self._escape = Dialogs(), EscapeKey(blueprint)
        self._actions = PageActions(texts, self._dialogs, lambda: feed.now, consent)
        self._asking = Asking(self._view, setup, self._sender, self._actions)
        self._versions = (-1, -1)
        self._browser = ui.context.client
        ui.add_css(STYLE)
        ui.add_css(BUTTON_STYLE)
        ui.add_body_html(f"<script>{HOLD_SCRIPT.read_text(encoding='utf-8')}</script>")
        ui.colors(primary="#0b5394")
        ui.query(".nicegui-content").classes("p-0 gap-0")
        ui.keyboard(on_key=self._escaped, ignore=[])
        ui.keyboard(on_key=self._plan_by_key, ignore=["input", "textarea"])
        self._header()
        self._trouble = ui.label().classes("w-full bg-red-2 q-pa-sm").props('data-testid="trouble"')
        if setup.point_to_point:
            ui.label(texts("point_to_point")).classes("w-full bg-orange-2 q-pa-sm").props(
                'data-testid="point-to-point"'
            )
        if playback is not None:
            name, shown = playback
            PlaybackBar(shown, name, texts)
        with ui.splitter(value=50).classes("w-full halves").props(f':horizontal="{IS_NARROW}"') as halves:
            with halves.before, ui.column().classes("w-full h-full gap-0 no-wrap"):
                self._left(surfaces)
            with halves.after, ui.column().classes("w-full gap-0 q-pa-xs"):
                self._next = NextPanel(self._view, blueprint, self._actions, self._asking, self._open_planning)
                self._right(recordings)
        ui.timer(REFRESH_PERIOD, self._refresh)
        ui.timer(BEAT_PERIOD, self._send_beat)

    @property
    def _is_playback(self) -> bool:
        return self._view is not self._feed

    def _header(self) -> None:
        texts = self._texts
        with ui.header().classes("items-center no-wrap q-py-none gap-x-2 gap-y-0 bg-blue-grey-10 head"):
            stop = ui.button(f"{texts('stop')} ({texts('stop_key')})", on_click=self._sender.stop, color="red-9")
            stop.props("size=md no-caps unelevated").classes("text-weight-bold").style("min-height: 48px")
            stop.props('data-testid="stop"')
            self._latched = ui.badge(color="red-9").props('data-testid="latched"')
            with ui.column().classes("gap-0").style("min-width: 0; flex-shrink: 1"):
                ui.label(self._blueprint.title or self._blueprint.id).classes("text-weight-bold ellipsis w-full")
                signed = texts("signed_in", user=self._setup.user, role=self._setup.role)
                simulated = f", {texts('simulated')}" if "sim" in self._setup.drivers.values() else ""
                user = ui.label(f"{signed}{simulated}").classes("text-caption ellipsis w-full")
                user.props('data-testid="signed-in"')
            with ui.column().classes("gap-0 items-start"):
                self._lease = ui.label().classes("caption").props('data-testid="lease"')
                self._holding = ui.button(on_click=self._hold).props("flat dense no-caps color=white")
                self._holding.props('data-testid="hold"')
            ui.space()
            with ui.column().classes("gap-0 items-end"):
                ui.label(texts("error_now")).classes("caption")
                self._error = ui.label().classes("figure").props('data-testid="error"')
            ui.space()
            ui.label(texts("research")).classes("caption").style("max-width: 130px; white-space: normal")
            ui.toggle(list(languages()), value=texts.language, on_change=_in_language).props("dense size=sm").props(
                'data-testid="language"'
            )

    def _left(self, surfaces: Surfaces) -> None:
        texts = self._texts
        with ui.tabs().props("dense no-caps align=left") as tabs:
            ui.tab("scene", texts("scene"))
            ui.tab("chart", texts("chart"))
        with ui.tab_panels(tabs, value="scene", animated=False, keep_alive=True).classes("w-full left-panels"):
            with ui.tab_panel("scene").classes("p-0").style("overflow: hidden"):
                CellPanel(self._view, self._setup, texts, surfaces)
            with ui.tab_panel("chart").classes("p-0"):
                self._chart = ChartPanel(self._blueprint)

    def _right(self, recordings: Recordings) -> None:
        texts, feed, setup = self._texts, self._feed, self._setup
        names = ["workflow", "planning", "signals", "session"]
        if self._is_playback:
            names.remove("planning")
        with ui.tabs().props("dense no-caps align=left") as tabs:
            for name in names:
                ui.tab(name, texts(name)).props(f'data-testid="tab-{name}"')
        self._planning: PlanningPanel | None = None
        with ui.tab_panels(tabs, value="workflow", animated=False, keep_alive=True).classes("w-full"):
            with ui.tab_panel("workflow").classes("p-1"):
                self._workflow = WorkflowPanel(self._view, setup, self._blueprint, self._actions, self._asking)
            if not self._is_playback:
                with ui.tab_panel("planning").classes("p-1"):
                    self._planning = PlanningPanel(feed, setup, self._blueprint, texts, self._sender)
            with ui.tab_panel("signals").classes("p-1"):
                SignalsPanel(self._view, setup, texts, lambda: tabs.value == "signals")
            with ui.tab_panel("session").classes("p-1"):
                choose_recording(recordings, texts)
                self._timeline = TimelinePanel(feed, self._view, setup, texts)
        self._right_tabs = tabs
        tabs.on_value_change(self._timeline.refresh)

    def _refresh(self) -> None:
        feed, view = self._feed, self._view
        measured = tool_tip(self._setup, view.poses.get("coil"))
        found = placement_deviation(view.data, measured, view.poses.get("body_ref"))
        self._error.set_text(
            self._texts("unknown") if found is None else f"{found.mm[0]:.2f} mm   {found.degrees:.2f}°"
        )
        if (feed.version, view.version) == self._versions:
            return
        self._versions = (feed.version, view.version)
        self._trouble.set_visibility(feed.client is None)
        self._trouble.set_text(self._texts("unreachable", why=feed.trouble))
        self._show_holder(feed.snapshot)
        shown = view.snapshot
        if shown is None:
            return
        self._chart.refresh(shown)
        choices = self._possible(shown)
        self._next.refresh(shown, choices)
        self._workflow.refresh(shown, choices)
        if self._planning is not None:
            self._planning.refresh(choices)
        if self._right_tabs.value == "session":
            self._timeline.refresh()

    def _show_holder(self, shown: Snapshot | None) -> None:
        """Show the present holder of the cell, also during a replay: Stop goes to the cell."""
        latch = latch_of(shown)
        self._latched.set_visibility(latch is not None)
        if latch is not None:
            self._latched.set_text(self._texts(latch))
        holder = None if shown is None or shown.lease is None else shown.lease.holder
        texts = self._texts
        self._lease.set_text(texts("nobody_holds") if holder is None else texts("holds", user=holder))
        self._holding.set_text(texts("release" if holder == self._setup.user else "take"))
        self._holding.set_visibility(not self._is_playback)

    def _possible(self, shown: Snapshot) -> dict[str, Choice]:
        choices = self._choices.all(shown, self._setup)
        why_not = self._texts("only_replay") if self._is_playback else ""
        if self._feed.client is None:
            why_not = self._feed.trouble
        return {name: replace(each, why_not=why_not or each.why_not) for name, each in choices.items()}

    def _send_beat(self) -> None:
        """Send the time to the browser, which returns it with each press: a press that waited is void."""
        self._browser.run_javascript(f'pcmrsPresses.beat("{beat_of(self._feed.now)}")')

    async def _hold(self) -> None:
        shown = self._feed.snapshot
        if shown is None:
            return
        holder = None if shown.lease is None else shown.lease.holder
        operation = "release" if holder == self._setup.user else "acquire" if holder is None else "take_over"
        await self._sender.hold(operation)

    def _open_planning(self, operation: str) -> None:
        """Open the planning of what an operation takes."""
        self._right_tabs.set_value("planning")
        if self._planning is not None:
            self._planning.choose(operation)

    async def _escaped(self, event: events.KeyEventArguments) -> None:
        if not event.action.keydown or event.key.name != "Escape":
            return
        shown = None if self._feed.client is None else self._feed.snapshot
        if self._escape.stops(shown, dialog=bool(self._dialogs)):
            await self._sender.stop()
        else:
            self._dialogs.close_newest()

    def _plan_by_key(self, event: events.KeyEventArguments) -> None:
        if event.action.keydown and self._planning is not None and event.key.name != "Escape":
            self._planning.key(event.key.name)


def _in_language(event: events.ValueChangeEventArguments[str]) -> None:
    ui.navigate.to(f"/?language={event.value}")
