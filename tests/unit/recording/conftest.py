"""A recording of a few chunks."""

from __future__ import annotations

import pytest

from tests.unit.recording.recording_bench import written


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[bytes]]:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    payloads = written(path)
    return path.read_bytes(), payloads
