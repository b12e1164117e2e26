"""An authority of a lab."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.pki import Authority


@pytest.fixture
def now() -> float:
    return SystemClock().wall()


@pytest.fixture
def authority(tmp_path: Path, now: float) -> Authority:
    return Authority.init(tmp_path / "pki", "lab", now)
