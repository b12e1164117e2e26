"""Pictures of the console for docs/console.md: ``make screenshots``, or this program with the folder they go to.

Starts a simulated cell and a console, hunts for a motor threshold, and takes the pictures with headless Chromium.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from playwright.sync_api import Page

from pcmrs.client import Client
from pcmrs.messages import Verdict
from pcmrs.service import Ready
from pcmrs.testing.daemon import own_settings, serve_command
from pcmrs.workflows.data import as_message
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.settings import SimSettings
from tests import ROOT
from tests.system.console.consoles import browser, console

SETTINGS = (
    "workflow=ratms_threshold", "sim.arm.physics=kinematic", "procedure.max_pose_age=3", "robot.deadman=1.0",
    "procedure.stimulation.intervals.least=1.5", "procedure.patient=phantom", "procedure.operator=Dr. Example",
    "recording.enabled=true",
    "procedure.tracking.volume=[{distance=0.5, width=0.4, height=0.4}, {distance=2.0, width=1.4, height=1.2}]",
)  # fmt: skip
MOST_PULSES = 60
DRAWN = 4_000
"""Without a graphics card a browser takes so long to draw what has changed, ms."""


def main(folder: Path) -> None:
    with TemporaryDirectory() as own:
        overrides = [each for each in own_settings(Path(own), "cell1") if not each.startswith("recording")]
        with subprocess.Popen(serve_command([*overrides, *SETTINGS]), stdout=subprocess.PIPE, text=True) as daemon:
            assert daemon.stdout is not None
            ready = msgspec.json.decode(daemon.stdout.readline(), type=Ready)
            _, site, cell = ready.prefix.split("/")
            where = ("--endpoint", ready.endpoint, "--site", site, "--cell", cell)
            recordings = ("--recordings", str(Path(ready.folder) / "recordings"))
            try:
                with console(*where, *recordings) as (_, url), browser(url) as page:
                    page.get_by_test_id("next").wait_for()
                    with ThreadPoolExecutor(1) as pool:  # Playwright's own event loop runs here
                        pool.submit(asyncio.run, hunt(ready.endpoint, site, cell)).result()
                    take(page, folder)
            finally:
                daemon.terminate()


async def hunt(endpoint: str, site: str, cell: str) -> None:
    """Places the coil on the hot-spot and hunts for the threshold."""
    plan = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())
    subject = draw_subject("head", SimSettings().seed)
    assert subject is not None
    spot = as_message(subject.image_from_hotspot)
    w, x, y, z = spot.quat_wxyz
    async with Client.connect(endpoint, site, cell) as client:
        await accept(client, "registration.plan_landmarks", landmarks=plan["landmarks"])
        await accept(client, "digitization.digitize_all")
        await accept(client, "registration.register")
        await accept(client, "toolplan.plan", position=list(spot.position), quat_xyzw=[x, y, z, w])
        await accept(client, "robot.connect")
        await accept(client, "placement.approach")
        await accept(client, "placement.confirm")
        await accept(client, "stimulation.set_ceiling", percent=90, operator="Dr. Example")
        await accept(client, "stimulation.set_intensity", percent=50)
        await accept(client, "stimulation.arm")
        await accept(client, "threshold.begin")
        for _ in range(MOST_PULSES):
            verdict = await client.call("threshold.pulse", {})
            if verdict.state != "hunting":
                return
            await asyncio.sleep(0.5)


async def accept(client: Client, name: str, **arguments: object) -> Verdict:
    """Asks until it is accepted: what the procedure does by itself may come between."""
    for _ in range(40):
        verdict = await client.call(name, arguments)
        if verdict.decision == "accepted":
            return verdict
        await asyncio.sleep(0.5)
    raise AssertionError(verdict)


def take(page: Page, folder: Path) -> None:
    """The pictures, one after the other."""

    def picture(name: str) -> None:
        page.wait_for_timeout(DRAWN)
        page.screenshot(path=folder / f"console-{name}.png")

    page.get_by_test_id("predicted-error").click()
    picture("workflow")
    page.get_by_test_id("tab-signals").click()
    page.get_by_test_id("threshold").wait_for()
    page.wait_for_timeout(DRAWN)
    page.get_by_test_id("chart-hunt").evaluate("element => element.scrollIntoView({block: 'end'})")
    picture("signals")
    page.get_by_role("tab", name="State chart").click()
    page.get_by_test_id("tab-session").click()
    page.get_by_test_id("watch").click()
    moment = page.get_by_test_id("moment")
    moment.wait_for()
    box = moment.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"])
    picture("replay")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
