"""Demo of a watched scene: a hand enters the workspace during an approach, the arm stops, and the procedure goes on."""

from __future__ import annotations

import asyncio
import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from pcmrs.messages import JointState
from pcmrs.messages.scene_event import WATCHING
from pcmrs.testing.cell import REAL_TIME, open_cell
from pcmrs.testing.driving import accept, acknowledge, to_retracted, until
from pcmrs_lab.experiment.scene_camera import WATCHED, scene_camera

BEGUN = 1.5
"""Time for which the approach runs before the hand enters, s."""
STANDS_BELOW = 1e-3
"""Joint speed below which the arm stands, rad/s."""
RETURNED = 2.0
"""Time for the daemon to count the source, and the workspace, as clear again, s."""


class SceneDemoReport(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the demo.

    Attributes:
        sure_after_ms: Time from the first image that shows the hand to the event that stops, ms: the second image with
            it, and its evaluation.
        braking_after_ms: Time from that first image to the first joints that show a slower arm, ms.
        standstill_after_ms: Time from it to the first joints of an arm that stands, ms.
        travelled_deg: Largest rotation of a joint from it to the standstill, deg.
        refused: Code with which the next motion was refused while the hand was there.
        went_on: Decision on the approach after the hand had left.
    """

    sure_after_ms: float
    braking_after_ms: float
    standstill_after_ms: float
    travelled_deg: float
    refused: str
    went_on: str


async def run_scene_demo(seed: int, overrides: Sequence[str], say: Callable[[str], None]) -> SceneDemoReport:
    """Run the demo on its own daemon and detector, in real time.

    Args:
        seed: Seed of the simulated errors.
        overrides: Further settings of the daemon, ``key=value`` each.
        say: Called with each step.

    Raises:
        DeviceError: The daemon did not start.
        Unmet: Something did not happen as it should.
    """
    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name:
        settings = (*REAL_TIME, *WATCHED, f"sim.seed={seed}", *overrides)
        async with open_cell(Path(name) / "demo", settings) as cell, scene_camera(cell) as camera:
            joints: list[tuple[float, JointState]] = []
            loop = asyncio.get_running_loop()
            cell.bus.subscribe("state/joints", JointState, lambda _, each: joints.append((loop.time(), each)))
            say("The detector knows the empty scene. The head is registered, and the tool is away from it.")
            await asyncio.sleep(RETURNED)
            await to_retracted(cell.client)
            moving = asyncio.create_task(cell.client.call("placement.approach"))
            await until(cell.client, lambda shown: bool(shown.running))
            await asyncio.sleep(BEGUN)
            say("The arm approaches, and a hand enters the workspace.")
            camera.show_hand()
            await moving
            await until(cell.client, lambda shown: shown.latched and not shown.stop.pending)
            seen = [event for _, event in camera.events if event.label == "intrusion"]
            first, sure = seen[0], next(event for event in seen if event.confidence >= 1.0)
            say(f"The detector has seen it (track {sure.track}, {sure.region}): the arm is held, and Stop is latched.")
            braking, standing, travelled = _braking(joints, first.captured)
            await acknowledge(cell.client)
            refusal = await cell.client.call("placement.follow")
            refused = refusal.reason.code if refusal.reason is not None else refusal.decision
            say(f"Acknowledged while the hand is there: the next motion is refused ({refused}).")
            camera.tell("hand away")
            await camera.until_seen(WATCHING)
            await asyncio.sleep(RETURNED)
            await accept(cell.client, "placement.back_off")
            await accept(cell.client, "placement.home")
            verdict = await accept(cell.client, "placement.approach")
            say("The hand has left: the tool is withdrawn, and approaches again.")
    return SceneDemoReport(
        sure_after_ms=(sure.sent - first.captured) * 1e3,
        braking_after_ms=braking * 1e3,
        standstill_after_ms=standing * 1e3,
        travelled_deg=math.degrees(travelled),
        refused=refused,
        went_on=verdict.decision,
    )


def _braking(joints: Sequence[tuple[float, JointState]], captured: float) -> tuple[float, float, float]:
    """Return when the arm was slower and when it stood after an image, s, and how far a joint turned, rad.

    Args:
        joints: All received joints with the time of their arrival, s of this machine's monotonic clock.
        captured: Time of the image, s of the same clock.
    """
    before = [state for at, state in joints if at <= captured][-1]
    speed = _speed(before)
    later = [(at, state) for at, state in joints if at > captured]
    # Constant or growing speed is no braking: a tenth less than at the image is.
    braking = next(at for at, state in later if _speed(state) < 0.9 * speed)
    stopped, last = next((at, state) for at, state in later if _speed(state) < STANDS_BELOW)
    turned = max(abs(a - b) for a, b in zip(last.positions, before.positions, strict=True))
    return braking - captured, stopped - captured, turned


def _speed(state: JointState) -> float:
    return max(map(abs, state.velocities))
