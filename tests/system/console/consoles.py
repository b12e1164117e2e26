"""The console as a process of its own, and a browser that opens it."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pcmrs.client import PlainClient
from pcmrs.testing.daemon import own_settings, serve_command
from pcmrs.testing.driving import landmarks, tool_pose

if TYPE_CHECKING:
    from playwright.sync_api import Page

CHROMIUM = shutil.which("chromium") or ""
FLAGS = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing",
]  # fmt: skip


@contextmanager
def console(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A console on a free port; yields its process and address."""
    command = [sys.executable, "-m", "pcmrs.cli", "console", "--port", "0", "--json", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())["url"]
        finally:
            process.terminate()
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def running_cell(folder: Path, *settings: str) -> Iterator[list[str]]:
    """A cell of its own; yields the options that reach it."""
    command = serve_command([*own_settings(folder / "cell", "seen"), *settings])
    with (folder / "log").open("w") as log:
        daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    with daemon:
        assert daemon.stdout is not None
        line = daemon.stdout.readline()
        assert line, (folder / "log").read_text()
        ready = json.loads(line)
        _, site, cell = ready["prefix"].split("/")
        try:
            yield ["--endpoint", ready["endpoint"], "--site", site, "--cell", cell]
        finally:
            daemon.terminate()
            daemon.wait(30.0)


@contextmanager
def client_of(address: list[str]) -> Iterator[PlainClient]:
    """A client at the options of `running_cell`."""
    options = dict(zip(address[::2], address[1::2], strict=True))
    with PlainClient.connect(options["--endpoint"], options["--site"], options["--cell"]) as cell:
        yield cell


def to_registered_head(cell: PlainClient) -> None:
    """All that comes before the first motion."""
    for operation, arguments in (
        ("registration.plan_landmarks", landmarks()),
        ("digitization.digitize_all", {}),
        ("registration.register", {}),
        ("toolplan.plan", tool_pose()),
        ("robot.connect", {}),
    ):
        ask(cell, operation, arguments)


def ask(cell: PlainClient, operation: str, arguments: dict[str, Any] | None = None) -> None:
    """An operation that has to be accepted, and the end of all that it sets going."""
    verdict = cell.call(operation, arguments)
    assert verdict.decision == "accepted", verdict
    cell.until(lambda state: not state.running)


@contextmanager
def browser(url: str, **device: Any) -> Iterator[Page]:
    """A page of headless Chromium; what it asks of other hosts, or its scripts stumble over, fails the test.

    Args:
        url: Of the page.
        device: On which it is opened, as Playwright describes one; a screen of 1280 x 720 otherwise.
    """
    from playwright.sync_api import sync_playwright

    trouble: list[str] = []
    with sync_playwright() as playwright, TemporaryDirectory() as folder:
        chromium = playwright.chromium.launch(executable_path=_behind_others(Path(folder)), args=FLAGS)
        page = chromium.new_page(**{"viewport": {"width": 1280, "height": 720}, **device})
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda error: trouble.append(str(error)))
        here = url.partition("?")[0]
        page.on("request", lambda request: None if _is_own(request.url, here) else trouble.append(request.url))
        page.goto(url)
        yield page
        chromium.close()
    assert not trouble


def _behind_others(folder: Path) -> Path:
    """Chromium that takes only the time that others leave: without a graphics card it would keep the daemon waiting."""
    program = folder / "chromium"
    program.write_text(f'#!/bin/sh\nexec chrt -i 0 {CHROMIUM} "$@"\n')
    program.chmod(0o700)
    return program


def _is_own(url: str, here: str) -> bool:
    return url.startswith((here, here.replace("http://", "ws://"), "data:", "blob:"))
