"""What the daemon's log shows of an exception."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator

import pytest
import structlog

from pcmrs.cli.serve import _log_to_stderr


@pytest.fixture
def stderr(monkeypatch: pytest.MonkeyPatch) -> Iterator[io.StringIO]:
    written = io.StringIO()
    monkeypatch.setattr(sys, "stderr", written)
    _log_to_stderr(verbose=False)
    yield written
    structlog.reset_defaults()


def _fail() -> None:
    patient = "name of the patient"
    raise ValueError(f"{len(patient)} letters")


def test_a_logged_exception_is_plain_and_shows_no_local_values(stderr: io.StringIO) -> None:
    try:
        _fail()
    except ValueError as error:
        structlog.get_logger().error("broken", exc_info=error)
    text = stderr.getvalue()
    assert "ValueError: 19 letters" in text
    assert "_fail" in text
    assert "'name of the patient'" not in text
    assert len(text.splitlines()) < 12
