"""The daemon's log: what it shows of an exception, and that nobody who logs is stopped by it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

import pytest
import structlog

from pcmrs.cli.log import MAX_WAITING, LogStream, log_to_stderr


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    reader, writer = os.pipe()
    yield reader, writer
    os.close(reader)
    os.close(writer)


def _fail() -> None:
    patient = "name of the patient"
    raise ValueError(f"{len(patient)} letters")


def test_a_logged_exception_is_plain_and_shows_no_local_values(capfd: pytest.CaptureFixture[str]) -> None:
    stream = log_to_stderr()
    try:
        _fail()
    except ValueError as error:
        structlog.get_logger().error("broken", exc_info=error)
    finally:
        structlog.reset_defaults()
    stream.close()
    text = capfd.readouterr().err
    assert "ValueError: 19 letters" in text
    assert "_fail" in text
    assert "'name of the patient'" not in text
    assert len(text.splitlines()) < 12


def test_everything_is_written_in_order_before_it_is_closed(pipe: tuple[int, int]) -> None:
    stream = LogStream(pipe[1])
    lines = [f"{number}\n" for number in range(100)]
    for line in lines:
        stream.write(line)
    stream.close()
    assert os.read(pipe[0], 10_000).decode() == "".join(lines)


def test_a_full_disk_raises_nothing_and_what_is_lost_is_counted() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    stream = LogStream(full)
    for _ in range(10):
        stream.write("no place for this\n")
    stream.close()
    os.close(full)
    assert stream.lost == 10


def test_blocked_log_reader_delays_nobody_and_sees_lines_lost(pipe: tuple[int, int]) -> None:
    reader, writer = pipe
    stream, line = LogStream(writer), "x" * 199 + "\n"
    for _ in range(2 * MAX_WAITING):
        stream.write(line)
    read = b""
    while _told_lost(read) < stream.lost or read.count(b"x\n") < 2 * MAX_WAITING - stream.lost:
        read += os.read(reader, 1 << 16)
    stream.close()
    assert 0 < stream.lost == _told_lost(read)


def _told_lost(text: bytes) -> int:
    return sum(int(count) for count in re.findall(rb"(\d+) lines of the log were lost\n", text))
