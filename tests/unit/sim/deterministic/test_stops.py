"""The lane of Stop in simulated time: presses are joined and remembered as on the real bus."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable

import pytest

from pcmrs.bus.stop import Press
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_sim.deterministic.network import Endpoint, Network
from pcmrs_sim.deterministic.stops import open_lane

Play = Callable[[Endpoint, Endpoint, list[tuple[str, int]]], Awaitable[None]]


def with_lane(play: Play, *, coded: bool = False) -> None:
    """Play with an operator, a process with a lane, and its Stops: source and number of presses."""

    others = set(threading.enumerate())

    async def run() -> None:
        network = Network(asyncio.get_running_loop(), 1, coded=coded)
        operator, daemon = network.endpoint("operator"), network.endpoint("daemon")
        stops: list[tuple[str, int]] = []

        def stop(source: str, presses: int) -> int:
            stops.append((source, presses))
            return len(stops)

        lane = open_lane(daemon, stop)
        await play(operator, daemon, stops)
        lane.end()
        operator.publish("stop/anna", press(9))
        before = list(stops)
        await asyncio.sleep(1.0)
        assert stops == before, "the lane has ended"
        assert "pcmrs-stop" not in {thread.name for thread in set(threading.enumerate()) - others}

    run_on_simulated_loop(run())


def press(number: int) -> Press:
    return Press(id=f"{number:032x}")


@pytest.mark.parametrize("coded", [False, True])
def test_a_press_that_arrives_twice_stops_once(coded: bool) -> None:
    async def play(operator: Endpoint, _daemon: Endpoint, stops: list[tuple[str, int]]) -> None:
        for each in (1, 1, 2):
            operator.publish("stop/anna", press(each))
            await asyncio.sleep(1.0)
        assert stops == [("bus:anna", 1)] * 2

    with_lane(play, coded=coded)


def test_presses_during_a_blocked_loop_are_joined_by_source() -> None:
    async def play(operator: Endpoint, daemon: Endpoint, stops: list[tuple[str, int]]) -> None:
        daemon.hold_up(0.4)
        for number, who in enumerate(("anna", "ben", "anna")):
            operator.publish(f"stop/{who}", press(number))
            await asyncio.sleep(0.1)
        assert stops == []
        await asyncio.sleep(1.0)
        assert stops == [("bus:anna", 2), ("bus:ben", 1)]

    with_lane(play)


def test_a_killed_process_stops_nothing() -> None:
    async def play(operator: Endpoint, daemon: Endpoint, stops: list[tuple[str, int]]) -> None:
        operator.publish("stop/anna", press(1))
        daemon.leave()
        await asyncio.sleep(1.0)
        assert stops == []

    with_lane(play)
