"""A page of somebody else, open in a browser on the cell's machine, commands nothing on any port of the daemon."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from pcmrs.testing.daemon import free_port
from tests.system.console.consoles import CHROMIUM, FLAGS
from tests.system.daemon.daemon_process import ServeProcess, own_settings, running_daemon

pytest.importorskip("playwright")

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]

COMMAND = ";rob_conn_onxxxxx_#1;"
LISTENS = "0A"
"""State of a listening socket in /proc/net/tcp."""

ATTACK = """
async ([port, body]) => {
    const url = `http://127.0.0.1:${port}/`;
    const enough = () => ({signal: AbortSignal.timeout(3000)});
    const options = {method: "POST", mode: "no-cors", body};
    const post = type => fetch(url, {...options, headers: {"Content-Type": type}, ...enough()});
    const ended = await Promise.allSettled([post("text/plain"), post("application/x-www-form-urlencoded")]);
    await new Promise(done => {
        const link = new WebSocket(`ws://127.0.0.1:${port}/?${encodeURIComponent(body)}`);
        link.onopen = () => link.send(body);
        link.onerror = link.onclose = done;
        setTimeout(done, 3000);
    });
    const frame = document.createElement("iframe"), form = document.createElement("form");
    frame.name = `frame${port}`;
    document.body.append(frame, form);
    Object.assign(form, {action: url, method: "POST", enctype: "text/plain", target: frame.name});
    form.innerHTML = `<input name="${body}" value="">`;
    form.submit();
    await new Promise(done => setTimeout(done, 1500));
    return ended.length;
}
"""
"""All that a page may send to another server without asking it first."""


class Page(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>Somebody else</title><body>")

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def foreign_page() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()


@contextmanager
def recorder() -> Iterator[tuple[int, list[bytes]]]:
    """A port that keeps what is sent to it."""
    received: list[bytes] = []

    def serve() -> None:
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            connection.settimeout(0.5)
            with connection:
                try:
                    while data := connection.recv(4096):
                        received.append(data)
                except OSError:
                    pass

    with socket.create_server(("127.0.0.1", 0)) as listening:
        Thread(target=serve, daemon=True).start()
        yield listening.getsockname()[1], received
        listening.shutdown(socket.SHUT_RDWR)


def listening_ports(pids: list[int]) -> set[int]:
    """TCP ports at which these processes listen."""
    links = [str(each.readlink()) for pid in pids for each in Path(f"/proc/{pid}/fd").iterdir() if each.is_symlink()]
    sockets = {found[1] for each in links if (found := re.fullmatch(r"socket:\[(\d+)\]", each))}
    lines = [
        line.split() for kind in ("tcp", "tcp6") for line in Path(f"/proc/net/{kind}").read_text().splitlines()[1:]
    ]
    return {int(line[1].rpartition(":")[2], 16) for line in lines if line[3] == LISTENS and line[9] in sockets}


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[ServeProcess]:
    """With every link that there is."""
    settings = [
        *own_settings(tmp_path / "cell"), "console.enabled=true", f"console.port={free_port()}", "metrics.port=0",
        "gateway.openigtlink.enabled=true", "gateway.openigtlink.port=0",
    ]  # fmt: skip
    with running_daemon(settings, tmp_path) as process:
        yield process


def robot_of(daemon: ServeProcess) -> str:
    found = re.search(r'"robot": ?"(\w+)"', daemon.pcmrs("state", "--json").stdout)
    assert found
    return found[1]


def test_foreign_page_commands_nothing(daemon: ServeProcess) -> None:
    from playwright.sync_api import sync_playwright

    ports = listening_ports([daemon.process.pid, *daemon.children()])
    tcp = daemon.ready.links["tcp"]
    assert {tcp[1], daemon.ready.links["openigtlink"][1], int(daemon.ready.endpoint.rpartition(":")[2])} < ports
    with sync_playwright() as playwright, foreign_page() as url, recorder() as (control, received):
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page()
        page.goto(url)
        for port in (control, *sorted(ports)):
            page.evaluate(ATTACK, [port, COMMAND])
        browser.close()
    sent = b"".join(received)
    # The browser has sent what it was asked to; what ended without an answer it may have sent again.
    assert sent.count(b"POST / ") >= 3
    assert sent.count(COMMAND.encode()) >= 3
    assert b"Upgrade: websocket" in sent
    assert robot_of(daemon) == "0"
    assert "is not a command" in daemon.log or "cannot become a command" in daemon.log
    with socket.create_connection(tcp) as link:  # the same words of somebody who may
        link.sendall(COMMAND[1:].encode())
        assert link.recv(100).startswith(b"1_accepted")
    assert robot_of(daemon) == "1"
