"""The reader as a child of the driver: restarted when it ends, hangs or reports trouble."""

from __future__ import annotations

import os
import signal
from contextlib import aclosing

import pytest
import structlog

from tests.unit.devices.ndi_reader import ndi_tracker, readers, served_ndi


async def test_reader_that_is_killed_or_suspended_is_restarted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.devices.ndi.process.FRAME_TIME", 0.5)
    reasons = {
        signal.SIGKILL: "the reader ended with exit status -9",
        signal.SIGSTOP: "the reader has reported nothing for 0.5 s",
        signal.SIGALRM: "it does not answer",
        signal.SIGSEGV: "an answer was corrupted",
    }
    with structlog.testing.capture_logs() as logs:
        async with (
            served_ndi() as (_, device),
            ndi_tracker(device=device) as tracker,
            aclosing(tracker.frames()) as frames,
        ):
            assert await anext(frames)
            for ending in reasons:
                (reader,) = readers()
                os.kill(reader, ending)
                while readers() in ([], [reader]):
                    await anext(frames)
                assert await anext(frames)
    assert readers() == []
    told = [entry["reason"] for entry in logs if entry["event"] == "tracker_not_there"]
    assert told == [f"The tracker at {device}: {why}. Check that it is on, and its cable." for why in reasons.values()]
