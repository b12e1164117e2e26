"""Replay of a recorded session on the page: the bar with its slider, and the list of recordings."""

from __future__ import annotations

from datetime import datetime
from urllib.parse import quote

from nicegui import events, ui

from pcmrs.console._recordings import Recordings
from pcmrs.console.playback import Playback
from pcmrs.console.texts import Texts

PERIOD = 0.1
"""Period of steps while it plays, s."""
SPEEDS = {1: "1×", 4: "4×", 16: "16×"}


class PlaybackBar:
    """Controls for a recording.

    Args:
        playback: The recording.
        name: Its name.
        texts: Texts in the language of the page.
    """

    def __init__(self, playback: Playback, name: str, texts: Texts) -> None:
        self._playback, self._texts, self._plays = playback, texts, False
        with ui.row().classes("w-full items-center no-wrap gap-3 q-px-sm replay").props('data-testid="replay"'):
            ui.label(texts("replay", name=name)).classes("text-weight-bold ellipsis").style("max-width: 30%")
            self._button = ui.button(icon="play_arrow", on_click=self._press).props('data-testid="play"')
            self._button.props(f'aria-label="{texts("play")}" color=deep-purple-9')
            self._slider = ui.slider(
                min=0.0, max=max(0.1, playback.recorded.duration), step=0.1, value=0.0, on_change=self._moved
            ).props('data-testid="moment" color=deep-purple-9')  # fmt: skip
            self._time = ui.label().classes("whitespace-nowrap").props('data-testid="recorded-time"')
            self._speed = ui.toggle(SPEEDS, value=1).props("dense no-caps")
            ui.button(texts("to_cell"), on_click=lambda: ui.navigate.to("/")).props(
                'no-caps color=deep-purple-9 data-testid="to-cell"'
            ).classes("whitespace-nowrap")
        if playback.trouble:
            ui.label(playback.trouble).classes("w-full bg-orange-2 q-pa-xs")
        self._show_time()
        ui.timer(PERIOD, self._go_on)

    def _press(self) -> None:
        at_end = self._playback.position >= self._playback.recorded.duration
        if at_end and not self._plays:
            self._slider.set_value(0.0)
        self._plays = not self._plays
        self._button.props(f"icon={'pause' if self._plays else 'play_arrow'}")

    def _moved(self, event: events.ValueChangeEventArguments[float | None]) -> None:
        self._playback.seek(event.value or 0.0)
        self._show_time()

    def _go_on(self) -> None:
        if not self._plays:
            return
        position = self._playback.position + PERIOD * float(self._speed.value or 1)
        self._slider.set_value(min(position, self._playback.recorded.duration))
        if position >= self._playback.recorded.duration:
            self._press()

    def _show_time(self) -> None:
        at = datetime.fromtimestamp(self._playback.recorded.started_at + self._playback.position)
        whole = self._playback.recorded.duration
        self._time.set_text(f"{at:%Y-%m-%d %H:%M:%S}   {self._playback.position:.1f} / {whole:.0f} s")


def choose_recording(recordings: Recordings, texts: Texts) -> None:
    """Show a list of recordings, each with a link to its replay; nothing if there are none.

    Args:
        recordings: The recordings.
        texts: Texts in the language of the page.
    """
    names = recordings.names()
    if not names:
        return
    with ui.row().classes("items-center w-full no-wrap"):
        chosen = ui.select(names, label=texts("recordings"), value=names[0]).props("dense").classes("col-grow")
        chosen.props('data-testid="recordings"')
        ui.button(texts("watch"), on_click=lambda: ui.navigate.to(f"/?replay={quote(chosen.value)}")).props(
            'no-caps data-testid="watch"'
        )


def wait_for_recording(recordings: Recordings, texts: Texts) -> None:
    """Show the progress of reading a recording, or why it cannot be read.

    Args:
        recordings: The recordings.
        texts: Texts in the language of the page.
    """
    ui.label(texts("reading")).classes("text-h5")
    bar = ui.linear_progress(show_value=False).props("instant-feedback")
    why = ui.label().props('data-testid="trouble"')
    ui.button(texts("to_cell"), on_click=lambda: ui.navigate.to("/")).props("no-caps")

    def look() -> None:
        bar.set_value(recordings.progress)
        why.set_text(recordings.trouble)
        if recordings.is_read:
            ui.navigate.reload()

    ui.timer(0.3, look)


def refuse_recording(why: str, texts: Texts) -> None:
    """Show why a readable recording is not replayed.

    Args:
        why: The reason.
        texts: Texts in the language of the page.
    """
    ui.label(why).props('data-testid="trouble"')
    ui.button(texts("to_cell"), on_click=lambda: ui.navigate.to("/")).props("no-caps")
