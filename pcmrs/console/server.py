"""The console's web server, in its own process: never in the process that controls."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from nicegui import Client, ui

from pcmrs.console._connections import limited_protocol
from pcmrs.console._live_feed import Dial, LiveFeed
from pcmrs.console._page import Page
from pcmrs.console._playback_bar import refuse_recording, wait_for_recording
from pcmrs.console._recordings import Recordings
from pcmrs.console._surfaces import Surfaces
from pcmrs.console._uploads import UploadLimit, use_temporary_folder
from pcmrs.console.guard import TokenMiddleware
from pcmrs.console.planning.files import LARGEST as LARGEST_UPLOAD
from pcmrs.console.playback import Playback
from pcmrs.console.settings import MotionConsent
from pcmrs.console.texts import Texts
from pcmrs.errors import BusError, PcmrsError
from pcmrs.fsm import Blueprint, parse_blueprint

FORM_BYTES = 2**20
"""Limit of the bytes that a form adds to the files of an upload."""
LARGEST = 2**20
"""Limit of a message from a browser, bytes."""
RECONNECT_TIMEOUT, MESSAGE_HISTORY = 60.0, 10_000
"""A page continues after a disconnection of at most so long, s, and so many missed messages. Later it is reloaded, and
loses plans that were not sent."""
MOST_AT_ONCE = 512
"""Limit of open connections and of requests at once; another request is answered 503. A page needs about 6."""
SHUTDOWN_TIMEOUT = 1
"""Longest delay of the server's end by open pages, s."""


@dataclass(frozen=True, slots=True)
class ListenAddress:
    """Address at which the console listens, and its names.

    Attributes:
        port: Port; 0 for any free one.
        names: Further ``host:port`` that reach it, as behind a proxy.
        descriptor: File descriptor of a socket that already listens there; None to listen.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    names: tuple[str, ...] = ()
    descriptor: int | None = None


async def serve_console(
    dial: Dial,
    place: ListenAddress,
    token: str,
    language: str,
    ready: Callable[[str], None],
    ended: asyncio.Event,
    uploads: Path,
    recordings: Path | None = None,
    consent: MotionConsent = "hold",
) -> None:
    """Serve the page until `ended` is set.

    Args:
        dial: Connects to the daemon; the page is also served while it does not answer.
        place: Address at which to listen.
        token: Token that a request needs.
        language: Language of pages that ask for none.
        ready: Called with the address, token included, as soon as it can be opened.
        ended: Set to end it.
        uploads: Folder for uploaded files while they are read. Files of consoles that have ended are removed.
        recordings: Folder with recordings that can be replayed; None for none.
        consent: How a person shows that a motion is meant.

    Raises:
        BusError: The port is taken, or the address is not one of this machine.
        ConfigurationError: The folder for uploads cannot be made, or the token is too short.
    """
    feed = LiveFeed(dial)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    _build(app, feed, language, Recordings(recordings), consent)
    ui.run_with(
        app,
        title="PCMRS",
        show_welcome_message=False,
        reconnect_timeout=RECONNECT_TIMEOUT,
        message_history_length=MESSAGE_HISTORY,
    )
    with _listen(place) as listening:
        host, port = listening.getsockname()[:2]
        use_temporary_folder(uploads)
        names = {f"{name}:{port}" for name in (host, "127.0.0.1", "localhost")} | {*place.names}
        guarded = TokenMiddleware(UploadLimit(app, LARGEST_UPLOAD + FORM_BYTES), token, names)
        server = _Server(
            uvicorn.Config(
                guarded,
                http=limited_protocol(),
                limit_concurrency=MOST_AT_ONCE,
                log_level="warning",
                access_log=False,
                ws_max_size=LARGEST,
                ws_ping_interval=None,  # the page has its own pings, with a longer timeout
                timeout_graceful_shutdown=SHUTDOWN_TIMEOUT,
            )
        )
        async with asyncio.TaskGroup() as group:
            following = group.create_task(feed.run())
            serving = group.create_task(server.serve(sockets=[listening]))
            await server.serving.wait()
            ready(f"http://{host}:{port}/?token={token}")
            await ended.wait()
            server.should_exit = True
            await serving
            following.cancel()


class _Server(uvicorn.Server):
    """Server that reports when it serves."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.serving = asyncio.Event()

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the caller."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self.serving.set()


def _listen(place: ListenAddress) -> socket.socket:
    if place.descriptor is not None:
        return socket.socket(fileno=place.descriptor)
    try:
        return socket.create_server((place.host, place.port))
    except OSError as error:
        text = f"The console cannot listen at {place.host}:{place.port}: {error.strerror}. Give another --port."
        raise BusError(text, host=place.host, port=place.port) from None


def _build(app: FastAPI, feed: LiveFeed, language: str, recordings: Recordings, consent: MotionConsent) -> None:
    """Declare the pages that the server answers."""
    workflows: dict[str, Blueprint] = {}
    surfaces = Surfaces(feed)
    surfaces.declare(app)

    @ui.page("/")
    def page(language: str = language, replay: str = "") -> None:
        texts, setup = Texts(language), feed.setup
        if setup is None:
            _wait(feed, texts)
            return
        if setup.blueprint not in workflows:
            workflows[setup.blueprint] = parse_blueprint(setup.blueprint.encode(), origin="workflow")
        blueprint, playback = workflows[setup.blueprint], None
        if replay:
            recorded = recordings.get(replay)
            if recorded is None:
                wait_for_recording(recordings, texts)
                return
            try:
                playback = replay, Playback(recorded, setup, blueprint)
            except PcmrsError as error:
                refuse_recording(error.text, texts)
                return
        _follow(feed, ui.context.client)
        Page(feed, setup, blueprint, texts, surfaces, recordings, playback, consent)


def _follow(feed: LiveFeed, client: Client) -> None:
    """Have the feed follow what a page shows while a browser is connected to it."""

    def gone() -> None:
        if not client.has_socket_connection:  # a browser may connect again before its old connection has ended
            feed.page_closed(client.id)

    client.on_connect(lambda: feed.page_opened(client.id))
    client.on_disconnect(gone)


def _wait(feed: LiveFeed, texts: Texts) -> None:
    """Show a page until the daemon was reached for the first time."""
    ui.label(texts("title")).classes("text-h5")
    why = ui.label().props('data-testid="trouble"')

    def look() -> None:
        why.set_text(texts("unreachable", why=feed.trouble))
        if feed.setup is not None:
            ui.navigate.reload()

    ui.timer(0.5, look)
