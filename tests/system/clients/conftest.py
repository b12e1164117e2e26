"""The C# client, compiled once in a run of tests, however many processes run them."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from tests.system.clients.unity_programs import compile_client


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the compiled client and of its programs; needs mono."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder, unfinished = shared / "unity", shared / "unity-unfinished"
    with (shared / "unity.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            unfinished.mkdir(exist_ok=True)
            compile_client(unfinished)
            unfinished.rename(folder)  # whole, or not there
    return folder
