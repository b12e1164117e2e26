"""What tests of drivers in real time share."""

from __future__ import annotations

import pytest

from pcmrs.devices.kst import drive


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A test machine may leave this process alone for a while; what a stream does then has a test of its own."""
    monkeypatch.setattr(drive, "STALLED", 10.0)
