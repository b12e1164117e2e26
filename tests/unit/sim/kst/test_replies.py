"""How the cabinet's replies lie in TCP segments."""

import asyncio

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs_sim.kst.replies import Replies
from pcmrs_sim.robot_faults import Framing, RobotFaults
from tests.support.trials import examples


class Segments:
    """A connection that remembers what was written at once."""

    def __init__(self) -> None:
        self.written: list[bytes] = []

    def is_closing(self) -> bool:
        return False

    def write(self, data: bytes) -> None:
        if data:
            self.written.append(data)


class Turns(SystemClock):
    """Waits no longer than a turn of the event loop."""

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(0)
        await asyncio.sleep(0)


async def segments(framing: Framing, texts: list[str], seed: int = 1) -> list[bytes]:
    connection, faults = Segments(), RobotFaults(framing=framing)
    replies = Replies(connection, faults, Turns(), np.random.default_rng(seed))  # type: ignore[arg-type]
    running = asyncio.create_task(replies.run())
    for text in texts:
        replies.send(text)
        for _ in range(1 if framing == "merged" else 8):
            await asyncio.sleep(0)
    for _ in range(8):
        await asyncio.sleep(0)
    running.cancel()
    return connection.written


async def test_replies_lie_in_segments_as_configured() -> None:
    assert RobotFaults().framing == "whole", "others are a fault"
    assert await segments("whole", ["done\n", "nak\n"]) == [b"done\n", b"nak\n"]
    assert await segments("merged", ["done\n", "nak\n"]) == [b"done\nnak\n"]
    split = await segments("split", ["done\n"] * 5)
    assert len(split) == 10
    assert b"".join(split) == b"done\n" * 5


@examples(20)
@given(
    seed=st.integers(0, 2**32), texts=st.lists(st.sampled_from(["done\n", "0.5_1.0E-4_\n"]), min_size=60, max_size=80)
)
def test_mixed_replies_lose_nothing(seed: int, texts: list[str]) -> None:
    written = asyncio.run(segments("mixed", texts, seed))
    assert b"".join(written) == "".join(texts).encode()
    assert written == asyncio.run(segments("mixed", texts, seed))


async def test_mixed_replies_are_split_now_and_then() -> None:
    assert len(await segments("mixed", ["done\n"] * 200)) > 205
