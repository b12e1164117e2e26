"""Settings of recordings: limits in megabytes, and topics that can be recorded."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.recording.settings import RecordingSettings
from pcmrs.recording.topics import check_topics


def test_limits_are_in_bytes() -> None:
    settings = RecordingSettings(file_mb=1.5, total_mb=20.0, file_s=60.0, keep_free_mb=0.5)
    limits = settings.limits()
    assert (limits.file_bytes, limits.total_bytes, limits.keep_free_bytes) == (1.5e6, 20e6, 0.5e6)
    assert limits.file_s == 60.0


def test_sessions_are_recorded_within_limits_by_default() -> None:
    """A daemon that runs for months must leave room for the journal."""
    settings = RecordingSettings()
    limits = settings.limits()
    assert settings.enabled
    assert limits.numbered
    assert limits.file_bytes is not None
    assert limits.total_bytes is not None
    assert 0 < limits.file_bytes < limits.total_bytes
    assert limits.keep_free_bytes > 0
    check_topics(settings.topics)


@pytest.mark.parametrize(
    "values", [{"file_mb": 0.0}, {"total_mb": -1.0}, {"file_s": 0}, {"keep_free_mb": -1}, {"mb": 1}]
)
def test_limits_that_cannot_be_meant_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(values, RecordingSettings)
