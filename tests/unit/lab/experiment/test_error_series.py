"""What is measured while a tool follows: true errors from the scene, measured ones from two bodies of one frame."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from pcmrs.devices.remote import RemoteScene
from pcmrs.messages import BodyPose, PoseMessage, SceneTruth
from pcmrs.spatial import Transform
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.experiment.error_series import HISTORY, PERIOD, ErrorSeries, PlacementErrorMonitor
from tests.unit.lab.scripted_client import ScriptedClient, snapshot

IDENTITY = (1.0, 0.0, 0.0, 0.0)
ORIGIN = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=IDENTITY)
DESIRED = Transform.from_quat_wxyz((0.0, 0.0, 0.1), IDENTITY)
"""Place of the coil on the body: 100 mm above it."""
TIP = Transform.from_rotvec((0.05, 0.0, 0.08), (0.0, 0.0, 0.0))
"""Contact point of the coil in its marker body."""


class Scene:
    """A scene whose coil is off by `off` m and whose time passes `rate` times as fast as the loop's."""

    def __init__(self, rate: float = 1.0) -> None:
        self.off = 0.0
        self._rate = rate

    async def truth(self) -> SceneTruth:
        coil = PoseMessage(position=(self.off, 0.0, 0.1), quat_wxyz=IDENTITY)
        time = asyncio.get_running_loop().time() * self._rate
        return SceneTruth(tracker_from_coil=coil, tracker_from_body_ref=ORIGIN, body_ref_from_image=ORIGIN, time=time)


def monitor(client: ScriptedClient, scene: Scene, rate: float = 1.0) -> PlacementErrorMonitor:
    return PlacementErrorMonitor(client.as_client, cast(RemoteScene, scene), DESIRED, TIP, rate)


def pose(body: str, number: int, off: float = 0.0, **more: Any) -> BodyPose:
    position = (off - 0.05, 0.0, 0.02) if body == "coil" else (0.0, 0.0, 0.0)
    given: dict[str, Any] = {"frame_number": number, "captured": 0.0, "sent": 0.0, "valid": True}
    return BodyPose(body=body, **(given | {"position": position, "quat_wxyz": IDENTITY} | more))


def test_errors_while_blocked_do_not_count_as_allowed() -> None:
    series = ErrorSeries(true_mm=[0.1, 2.0, 3.0, 0.2], allowed=[True, True, False, True])
    assert series.true_allowed_mm().tolist() == [0.1, 2.0, 0.2]
    assert ErrorSeries().true_allowed_mm().tolist() == []


def test_true_errors_are_sampled_until_the_time_is_over() -> None:
    client, scene = ScriptedClient(placement="following"), Scene()

    async def watch() -> ErrorSeries:
        watching = monitor(client, scene)
        client.handlers["state/fsm"](await client.state())
        scene.off = 0.002
        return await watching.watch(1.0)

    series = run_on_simulated_loop(watch())
    assert series.true_mm == pytest.approx([2.0] * len(series.times))
    assert series.times[-1] == pytest.approx(1.0, abs=PERIOD)
    assert all(series.allowed)


@pytest.mark.parametrize("even_if_lost", [False, True])
def test_tool_that_was_lost_ends_the_run_unless_that_is_watched(even_if_lost: bool) -> None:
    client = ScriptedClient(placement="following")

    async def watch() -> ErrorSeries:
        watching = monitor(client, Scene())
        client.handlers["state/fsm"](await client.state())
        lost = snapshot(placement="held", alignment="0")
        asyncio.get_running_loop().call_later(0.5, client.handlers["state/fsm"], lost)
        return await watching.watch(2.0, even_if_lost=even_if_lost)

    series = run_on_simulated_loop(watch())
    assert series.times[-1] == pytest.approx(2.0 if even_if_lost else 0.5, abs=2 * PERIOD)
    assert not series.allowed[-1]


async def test_both_bodies_of_a_frame_give_one_measured_error() -> None:
    client = ScriptedClient(placement="following")
    watching = monitor(client, Scene())
    client.handlers["state/fsm"](await client.state())
    task = asyncio.create_task(watching.watch(1e9))
    await asyncio.sleep(0)
    take = client.handlers["state/pose/*"]
    for each in (
        pose("coil", 1, 0.001),
        pose("body_ref", 2),  # of another frame
        pose("pointer", 1),
        pose("body_ref", 1),  # later than its coil
        pose("coil", 2, 0.003),
        pose("coil", 3, valid=False),
        pose("body_ref", 3),
        pose("coil", 4),
        pose("coil", 4),  # repeated
    ):
        take(each)
    client.handlers["state/fsm"](snapshot(placement="held", alignment="0"))
    assert (await task).measured_mm == pytest.approx([1.0, 3.0])
    take(pose("coil", 9))
    take(pose("body_ref", 9))
    assert len((await task).measured_mm) == 2, "frames after the run do not count"


async def test_frames_that_never_get_their_other_body_are_dropped() -> None:
    client = ScriptedClient(placement="following")
    watching = monitor(client, Scene())
    client.handlers["state/fsm"](await client.state())
    task = asyncio.create_task(watching.watch(1e9))
    await asyncio.sleep(0)
    for number in range(HISTORY + 1):
        client.handlers["state/pose/*"](pose("coil", number))
    for number in (0, HISTORY):
        client.handlers["state/pose/*"](pose("body_ref", number))
    client.handlers["state/fsm"](snapshot(placement="held", alignment="0"))
    assert len((await task).measured_mm) == 1


def test_alignment_is_waited_for_no_longer_than_allowed() -> None:
    client = ScriptedClient()

    async def wait(shown_after: float) -> tuple[bool, float]:
        watching, loop = monitor(client, Scene()), asyncio.get_running_loop()
        assert watching.state("alignment") == ""
        client.handlers["state/fsm"](snapshot(alignment="0"))
        loop.call_later(shown_after, client.handlers["state/fsm"], snapshot(alignment="1"))
        begun = loop.time()
        return await watching.aligned(5.0), loop.time() - begun

    assert run_on_simulated_loop(wait(2.0)) == (True, 2.0)
    assert run_on_simulated_loop(wait(7.0)) == (False, 5.0)
