"""Files of a running daemon, and daemons that must not start: second ones."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from tests.system.daemon.daemon_process import ServeProcess, as_words, own_settings, run_pcmrs, running_daemon


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeProcess]:
    """A daemon whose folder others may read, as an earlier version left it; its umask is that of a shell."""
    parent = tmp_path_factory.mktemp("first")
    folder = parent / "cell"
    folder.mkdir(mode=0o755)
    before = os.umask(0o022)
    try:
        with running_daemon([*own_settings(folder), *LIGHT], parent) as daemon:
            yield daemon
    finally:
        os.umask(before)


def _starts_not(settings: list[str], status: int, word: str) -> None:
    ended = run_pcmrs("serve", *as_words(settings))
    assert ended.returncode == status, ended.stderr
    assert ended.stdout == ""
    (line,) = [line for line in ended.stderr.splitlines() if "pcmrs.cli serve: " in line]
    assert word in line
    assert "Traceback" not in ended.stderr


def test_files_of_a_cell_are_readable_by_their_owner_only(daemon: ServeProcess) -> None:
    folder = Path(daemon.ready.folder)
    kept = [folder, *folder.rglob("*")]
    assert len(kept) > 2
    assert {path.name: oct(path.stat().st_mode & 0o077) for path in kept} == {path.name: "0o0" for path in kept}


def test_a_second_daemon_on_the_same_bus_endpoint_is_refused(daemon: ServeProcess, tmp_path: Path) -> None:
    endpoint = daemon.ready.endpoint
    _starts_not([*own_settings(tmp_path), f"cell.endpoint={endpoint}"], 3, endpoint)


def test_a_second_daemon_of_the_same_cell_is_refused(daemon: ServeProcess) -> None:
    other = f"cell.endpoint=tcp/127.0.0.1:{free_port()}"
    _starts_not([*daemon.settings, other], 4, daemon.ready.folder)


def test_a_second_daemon_on_the_same_link_is_refused(daemon: ServeProcess, tmp_path: Path) -> None:
    _, port = daemon.ready.links["planner"]
    _starts_not([*own_settings(tmp_path), *LIGHT, f"gateway.planner={{port={port}}}"], 4, str(port))
