"""Windows: how long they last, by seed and by script."""

from __future__ import annotations

import asyncio

from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_sim.deterministic.windows import LONGEST, Windows


def drawn(seed: int, names: list[str], share: float = 1.0) -> list[float]:
    async def play() -> list[float]:
        windows = Windows(asyncio.get_running_loop(), seed, share)
        return [windows.open(name) for name in names]

    return run_on_simulated_loop(play())


def test_without_a_share_no_window_takes_time() -> None:
    assert drawn(1, ["send:a", "write:b"] * 10, share=0.0) == [0.0] * 20


def test_a_duration_is_that_of_its_seed_name_and_number() -> None:
    """It stays if a script leaves out other windows."""
    alone, among = drawn(1, ["a", "a", "a"]), drawn(1, ["b", "a", "c", "a", "b", "a"])
    assert alone == [among[1], among[3], among[5]]
    assert len(set(alone)) == 3
    assert alone != drawn(2, ["a", "a", "a"])
    assert all(0.0 < duration < LONGEST for duration in alone)


def test_about_the_share_of_the_windows_takes_time() -> None:
    durations = drawn(3, ["a"] * 1000, share=0.2)
    assert 150 < sum(duration > 0.0 for duration in durations) < 250


def test_a_script_lengthens_the_next_window_of_its_pattern_only() -> None:
    async def play() -> None:
        windows = Windows(asyncio.get_running_loop(), 1)
        reached = asyncio.ensure_future(windows.reached("write:*", 0.3, 1.0))
        await asyncio.sleep(0.1)
        assert windows.open("send:row") == 0.0
        assert windows.open("write:row") == 0.3
        assert windows.open("write:row") == 0.0
        assert await reached
        assert (windows.opened["write:row"], windows.slow) == (2, 1)

    run_on_simulated_loop(play())


def test_a_script_stops_waiting_after_its_timeout() -> None:
    async def play() -> None:
        windows = Windows(asyncio.get_running_loop(), 1)
        assert not await windows.reached("write:*", 0.3, 2.0)
        assert asyncio.get_running_loop().time() >= 2.0
        assert windows.open("write:row") == 0.0

    run_on_simulated_loop(play())


def test_each_window_is_reported_with_its_duration() -> None:
    async def play() -> None:
        windows, opened = Windows(asyncio.get_running_loop(), 1), list[tuple[str, float]]()
        windows.on_open = lambda name, duration: opened.append((name, duration))
        windows.open("plan:placement.approach")
        windows.share = 1.0
        windows.open("plan:placement.approach")
        assert [name for name, _ in opened] == ["plan:placement.approach"] * 2
        assert opened[0][1] == 0.0 < opened[1][1]

    run_on_simulated_loop(play())
