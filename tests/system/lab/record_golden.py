"""Records the golden journals anew: real daemons on simulated devices, one for each workflow. Run by hand.

    python -m tests.system.lab.record_golden [WORKFLOW ...]

Each is led to the patient, refused, stopped, flooded, robbed of its drives in a motion, killed in another (kill -9),
started again, toured at random for a while, and ended in order. What is written is the export of its journal without
hashes, boot id and folder, so that a change of behaviour is a readable difference. Look at it before it is committed.
"""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import tempfile
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.devices.remote import RemoteScene
from pcmrs.journal import JournalReader
from pcmrs.messages import Verdict
from pcmrs.testing.driving import acknowledge
from pcmrs.testing.plan import Plan, example_plan, read_plan
from pcmrs.workflows.opening import open_workflow
from pcmrs_lab.experiment.tours.arguments import TourArguments, plan_arguments
from pcmrs_lab.experiment.tours.run import tour_live
from pcmrs_lab.experiment.treatment import prepare, treat
from tests.system.daemon import daemon_process
from tests.system.daemon.daemon_process import ServeProcess, own_settings, running_daemon
from tests.unit.replay.golden import GOLDEN, WORKFLOWS

START_TIME = 300.0
"""A machine that does much else takes its time, and nobody waits for a recording, s."""
TOUR = 12.0
"""Of the machine, s."""
LIMIT = 100_000
IN_MOTION = 0.25
DIGITIZING = "sim.digitization.reach_time=8"
"""So long, s of the cell, that Stop finds landmarks being digitized and something else waiting."""
"""So long after it was asked for, a motion is under way, s of the machine."""

UNSEEN = ("pose_missing", "pose_stale")
"""Reasons that pass by themselves on a machine that is busy."""

Course = Callable[[ServeProcess, Client, str], Awaitable[None]]


async def first_run(daemon: ServeProcess, client: Client, workflow: str) -> None:
    """To the body, with refusals, bursts, Stop and a fault on the way; the caller kills it in a motion."""
    plan = _plan_of(workflow)
    arguments: dict[str, Any] = plan_arguments(plan)
    landmarks, pose = arguments["landmarks"], _planning(workflow, arguments)
    await _told(client, "registration.register")
    await _told(client, "registration.plan_landmarks", {"landmarks": [{"name": "one", "position": [120.0, 0.0, 0.0]}]})
    for _ in range(2):
        await _told(client, "registration.plan_landmarks", landmarks)
    await _told(client, "digitization.digitize_one", {"index": 99})
    await _told(client, "digitization.digitize_one", {"index": 0})
    await _stopped(client, _told(client, "digitization.digitize_all"), _told(client, "registration.clear_landmarks"))
    await _told(client, "digitization.digitize_all")
    await _told(client, "registration.register", {"unexpected": 1})
    await _told(client, "registration.register")
    await _told(client, *pose)
    await _told(client, "placement.approach")
    await _told(client, "robot.connect")
    await _located(client)
    await prepare(client, workflow)
    await acknowledge(client)
    names = ("placement.approach", "placement.approach", "toolplan.clear", "registration.clear_registration")
    await asyncio.gather(*(_told(client, name) for name in names))
    await _to_the_body(client, landmarks, pose, workflow)
    await _treat(client, workflow)
    await _told(client, "placement.nudge", {"translation": [0.0, 0.0, 0.002]})
    await _told(client, "placement.back_off")
    async with daemon.bus() as bus:
        scene = RemoteScene(bus, SystemClock())
        moving = asyncio.create_task(_told(client, "placement.home"))
        await asyncio.sleep(IN_MOTION)
        await scene.inject("e_stop", {"on": True})
        await moving
        await _told(client, "placement.back_off")
        await scene.inject("e_stop", {"on": False})
    await acknowledge(client)
    await _told(client, "placement.back_off")
    await _told(client, "placement.home")
    await _stopped(client, _told(client, "placement.approach"))
    await acknowledge(client)
    await _told(client, "placement.back_off")


async def second_run(daemon: ServeProcess, client: Client, workflow: str) -> None:
    """After a kill: what was left is taken back; then a random tour."""
    blueprint = open_workflow(workflow).blueprint
    arguments = plan_arguments(_plan_of(workflow))
    await _told(client, "placement.approach")
    await _told(client, "registration.use_previous")
    await _told(client, "robot.connect")
    await _located(client)
    await acknowledge(client)
    await tour_live(blueprint, client, TourArguments(arguments), LIMIT, TOUR, lambda *_: None)


def _plan_of(workflow: str) -> Plan:
    return read_plan(example_plan("femoroplasty" if workflow == "femoroplasty" else "ratms"))


def _planning(workflow: str, arguments: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    if workflow == "femoroplasty":
        return "toolplan.plan_trajectory", arguments["trajectory"]
    return "toolplan.plan", arguments["tool_pose"]


async def _to_the_body(client: Client, landmarks: Any, pose: tuple[str, dict[str, Any]], workflow: str) -> None:
    """Registers and plans where the burst has left nothing of that, and places the tool."""
    branches = (await client.state()).branches
    if branches["registration"] == "110":
        await _told(client, "registration.register")
    await _told(client, *pose)
    if (await client.state()).branches["placement"] == "held":
        await _told(client, "placement.back_off")
    if (await client.state()).branches["placement"] in ("retracted", "replanned"):
        await _told(client, "placement.approach")
    await _told(client, "placement.confirm")


async def _treat(client: Client, workflow: str) -> None:
    """What the workflow does at the body."""
    if workflow == "femoroplasty":
        await treat(client, workflow)
    if workflow == "grid_mapping":
        pose = msgspec.to_builtins(_plan_of(workflow).poses[0])
        await _told(client, "mapping.plan_grid", {"poses": [{**pose, "quat_xyzw": [0.0, 0.0, 0.0, 0.0]}]})
        await _told(client, "mapping.plan_grid", {"poses": [pose] * 9})
        await _told(client, "mapping.perform")
        await _told(client, "mapping.skip")
    if workflow == "ratms_threshold":
        await _told(client, "stimulation.set_ceiling", {"percent": 60.0, "operator": "simulated operator"})
        await _told(client, "stimulation.set_intensity", {"percent": 90.0})
        await _told(client, "stimulation.set_intensity", {"percent": 50.0})
        await _told(client, "stimulation.arm")
        await asyncio.sleep(1.0)
        await _told(client, "stimulation.fire")
        await _told(client, "stimulation.fire")
        await _told(client, "stimulation.disarm")
    if workflow != "femoroplasty":
        await _told(client, "placement.follow")
        await asyncio.sleep(0.5)
        await _told(client, "placement.stop_following")


async def _told(client: Client, name: str, arguments: dict[str, Any] | None = None) -> Verdict:
    for _ in range(10):
        verdict = await client.call(name, arguments or {}, timeout=60.0)
        code = verdict.reason.code if verdict.reason else ""
        sys.stderr.write(f"  {name}: {verdict.decision} {code}\n")
        if code not in UNSEEN:
            break
        await asyncio.sleep(0.5)
    return verdict


async def _stopped(client: Client, *work: Awaitable[Verdict]) -> None:
    """Stops what has begun, and what waits for it."""
    asked = []
    for each in work:
        asked.append(asyncio.ensure_future(each))
        await asyncio.sleep(IN_MOTION)
    await client.stop()
    await asyncio.gather(*asked)
    await acknowledge(client)


async def _located(client: Client) -> None:
    """The robot is looked for when it has connected; asks again where the tracker was late."""
    for _ in range(5):
        await asyncio.sleep(0.5)
        if (await client.state()).branches["placement"] != "unknown":
            return
        await _told(client, "placement.locate")


async def record(workflow: str, folder: Path) -> None:
    """Records the journal of one workflow into `GOLDEN`."""
    settings = [*own_settings(folder), f"workflow={workflow}", DIGITIZING]
    with running_daemon(settings, folder) as daemon:
        async with daemon.client() as client:
            await first_run(daemon, client, workflow)
            motion = asyncio.create_task(client.call("placement.home", {}, timeout=5.0))
            await asyncio.sleep(IN_MOTION)
            daemon.end(signal.SIGKILL)
            motion.cancel()
            await asyncio.gather(motion, return_exceptions=True)
    with running_daemon(settings, folder) as daemon:
        async with daemon.client() as client:
            await second_run(daemon, client, workflow)
        daemon.end()
        journal = Path(daemon.ready.journal)
    with JournalReader(journal) as reader:
        lines = [_line(msgspec.to_builtins(stored)) for stored in reader.read()]
    (GOLDEN / f"{workflow}.jsonl").write_text("".join(lines))
    sys.stderr.write(f"{workflow}: {len(lines)} rows\n")


def _line(stored: dict[str, Any]) -> str:
    """A row without what is of this machine, or would make every line differ."""
    stored |= {"previous_hash": "", "hash": ""}
    stored["row"]["boot_id"] = ""
    settings = (stored["row"].get("result") or {}).get("settings")
    if settings is not None:
        settings["cell"] |= {"folder": "", "name": "golden"}
    return json.dumps(stored, ensure_ascii=False, separators=(",", ":")) + "\n"


def main(workflows: Sequence[str]) -> None:
    daemon_process.START_TIME = START_TIME
    for workflow in workflows or WORKFLOWS:
        with tempfile.TemporaryDirectory() as folder:
            asyncio.run(record(workflow, Path(folder)))


if __name__ == "__main__":
    main(sys.argv[1:])
