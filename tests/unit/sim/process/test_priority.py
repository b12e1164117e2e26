"""The priority of a simulated world: as the machine permits, and only for the thread that asks."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from pcmrs_sim.process.priority import NICE, raise_priority


def nice_after(call: Callable[[], object]) -> int:
    """Nice value of a new thread after a call in it."""

    def run() -> int:
        call()
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    with ThreadPoolExecutor(1) as pool:
        return pool.submit(run).result()


def raise_it_by_hand() -> None:
    try:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
    except PermissionError:
        return


def test_the_priority_is_what_the_machine_permits() -> None:
    before = nice_after(lambda: None)
    assert nice_after(raise_priority) == nice_after(raise_it_by_hand) in {before, NICE}
    assert nice_after(lambda: None) == before, "other threads keep theirs"


def test_without_permission_the_world_runs_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> None:
        raise PermissionError

    before = nice_after(lambda: None)
    monkeypatch.setattr(os, "setpriority", refuse)
    assert nice_after(raise_priority) == before
