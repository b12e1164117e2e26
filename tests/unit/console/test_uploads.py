"""The server bounds what it takes, and removes what a killed console has left of a patient."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import uvicorn

from pcmrs.console._uploads import UploadLimit, use_temporary_folder
from pcmrs.errors import ConfigurationError

LIMIT = 1000


async def post(*headers: str, body: bytes) -> tuple[int, list[bytes]]:
    """Status, and what the application was given, of a request to the server that the console uses."""
    given: list[bytes] = []

    async def application(scope: Any, receive: Any, send: Any) -> None:
        message = {"more_body": True}
        while message.get("more_body"):
            message = await receive()
            given.append(message["body"])
        await send({"type": "http.response.start", "status": 200})
        await send({"type": "http.response.body", "body": b""})

    async with serving(UploadLimit(application, LIMIT)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        head = "\r\n".join(("POST / HTTP/1.1", "Host: here", "Connection: close", *headers))
        writer.write(head.encode() + b"\r\n\r\n" + body)
        status = int((await reader.readline()).split()[1])
        writer.close()
    return status, given


@asynccontextmanager
async def serving(application: Any) -> AsyncIterator[int]:
    """The port at which it is served."""
    server = uvicorn.Server(uvicorn.Config(application, port=0, lifespan="off", log_level="critical"))
    server.config.load()
    server.lifespan = server.config.lifespan_class(server.config)
    await server.startup()
    try:
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


async def test_upload_within_the_limit_is_taken() -> None:
    status, given = await post(f"Content-Length: {LIMIT}", body=bytes(LIMIT))
    assert (status, b"".join(given)) == (200, bytes(LIMIT))


async def test_upload_declared_too_long_is_refused_unread() -> None:
    assert await post(f"Content-Length: {LIMIT + 1}", body=bytes(LIMIT + 1)) == (413, [])


async def test_upload_without_a_length_is_refused_unread() -> None:
    pieces = b"".join(b"%x\r\n%b\r\n" % (length, bytes(length)) for length in (600, 500)) + b"0\r\n\r\n"
    assert await post("Transfer-Encoding: chunked", body=pieces) == (411, [])
    assert await post("Content-Length: 10", "Transfer-Encoding: chunked", body=pieces) in ((411, []), (400, []))


async def test_upload_is_cut_at_its_declared_length() -> None:
    _, given = await post("Content-Length: 10", body=bytes(2 * LIMIT))
    assert b"".join(given) == bytes(10)


HOLDER = """
import pathlib, sys, tempfile
from pcmrs.console._uploads import use_temporary_folder
use_temporary_folder(pathlib.Path(sys.argv[1]))
file = tempfile.NamedTemporaryFile(prefix="patient")
folder = tempfile.mkdtemp()
print(file.name, flush=True)
input()
"""


@pytest.fixture
def uploads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", None)
    return tmp_path / "uploads"


def test_files_of_a_killed_process_are_removed_and_others_kept(uploads: Path) -> None:
    command, pipe = [sys.executable, "-c", HOLDER, str(uploads)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as holder:
        assert holder.stdout is not None
        file = Path(holder.stdout.readline().strip())
        use_temporary_folder(uploads)
        assert file.exists()
        holder.kill()
    assert file.exists(), "nobody has removed it"

    use_temporary_folder(uploads)

    assert not file.exists()
    assert [path for path in uploads.rglob("*") if path.is_file()] == []


def test_all_temporary_files_are_its_own_and_its_owners_alone(uploads: Path) -> None:
    use_temporary_folder(uploads)
    with tempfile.NamedTemporaryFile() as file, tempfile.TemporaryDirectory() as own:
        (folder,) = uploads.iterdir()
        assert {Path(file.name), Path(own)} == {*folder.iterdir()}
        assert [path.stat().st_mode & 0o777 for path in (uploads, folder)] == [0o700, 0o700]


def test_folder_that_cannot_be_made_is_an_error(uploads: Path) -> None:
    uploads.touch()
    with pytest.raises(ConfigurationError, match="cannot be made"):
        use_temporary_folder(uploads)
