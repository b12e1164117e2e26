"""A PostgreSQL server for tests: it has its own data, listens at no port, and ends with the tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
    user = USER if os.geteuid() == 0 else None

    def run(program: str, *words: str) -> None:
        command = [str(bin_ / program), "--pgdata", str(folder / "data"), *words]
        done = subprocess.run(
            command, user=user, cwd="/", env={"LC_ALL": "C"}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr

    try:
        if user is not None:
            shutil.chown(folder, user)
        run("initdb", "--username=pcmrs", "--auth=trust", "--encoding=UTF8", "--no-sync")
        log = str(folder / "log")
        run("pg_ctl", "--wait", f"--log={log}", f"--options=-k {folder} -c listen_addresses= -c fsync=off", "start")
        try:
            yield f"postgresql://pcmrs@/postgres?host={folder}"
        finally:
            run("pg_ctl", "--wait", "--mode=immediate", "stop")
    finally:
        shutil.rmtree(folder)
