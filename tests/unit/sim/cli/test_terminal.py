"""Lines and signals that a command gets from its terminal."""

import asyncio
import io
import os
import signal
import sys
from collections.abc import Iterator

import pytest

from pcmrs_sim.cli.terminal import forward_lines, termination

PATIENCE = 10.0  # s


@pytest.fixture(autouse=True)
def _terminal_signals() -> Iterator[None]:
    """What a command ignores in its process is not ignored in that of the tests."""
    before = signal.getsignal(signal.SIGTTIN)
    yield
    signal.signal(signal.SIGTTIN, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_sets_the_event_instead_of_ending_the_process(number: signal.Signals) -> None:
    ended = termination()
    try:
        assert not ended.is_set()
        os.kill(os.getpid(), number)
        async with asyncio.timeout(PATIENCE):
            await ended.wait()
    finally:
        for each in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().remove_signal_handler(each)


async def test_lines_arrive_in_order_and_blank_ones_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("e_stop on\n\n   \ntouch 0\nrelease"))
    lines: asyncio.Queue[str] = asyncio.Queue()
    forward_lines(lines.put_nowait)
    async with asyncio.timeout(PATIENCE):
        assert [(await lines.get()).strip() for _ in range(3)] == ["e_stop on", "touch 0", "release"]
    assert lines.empty()


async def test_reading_in_the_background_does_not_stop_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    forward_lines(lambda _: None)
    assert signal.getsignal(signal.SIGTTIN) is signal.SIG_IGN
