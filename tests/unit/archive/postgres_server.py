"""A PostgreSQL server for tests: it has its own data, listens at no port, and ends with the tests."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg
import pytest

DEBIAN = Path("/usr/lib/postgresql")
USER = "nobody"
"""User of the server if the tests run as root, which PostgreSQL refuses."""


def programs() -> Path:
    """Folder of the newest installed server; the test is skipped if there is none."""
    found = sorted(DEBIAN.glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    if not found:
        pytest.skip("PostgreSQL is not installed")
    return found[-1].parent


@contextmanager
def running_server() -> Iterator[str]:
    """Start a server and yield the address of its database."""
    folder, bin_ = Path(tempfile.mkdtemp(prefix="pcmrs-postgresql-")), programs()
    address = f"postgresql://pcmrs@/postgres?host={folder}"
    user, environment = USER if os.geteuid() == 0 else None, {"LC_ALL": "C"}
    try:
        if user is not None:
            shutil.chown(folder, user)
        make = [f"{bin_}/initdb", f"--pgdata={folder}/data", "--username=pcmrs", "--auth=trust", "--encoding=UTF8"]
        subprocess.run([*make, "--no-sync"], check=True, capture_output=True, user=user, cwd="/", env=environment)
        settings = (f"unix_socket_directories={folder}", "listen_addresses=", "fsync=off")
        start = [f"{bin_}/postgres", "-D", f"{folder}/data", *(word for each in settings for word in ("-c", each))]
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(start, stdout=log, stderr=log, user=user, cwd="/", env=environment)
        try:
            _wait(process, address, folder / "log")
            yield address
        finally:
            process.send_signal(signal.SIGINT)  # it ends the open connections
            process.wait(timeout=60)
    finally:
        shutil.rmtree(folder)


def _wait(process: subprocess.Popen[bytes], address: str, log: Path) -> None:
    """Wait until the server answers."""
    end = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < end:
        with suppress(psycopg.OperationalError):
            psycopg.connect(address).close()
            return
        time.sleep(0.1)
    pytest.fail(f"PostgreSQL does not answer:\n{log.read_text()}")
