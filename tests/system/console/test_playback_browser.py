"""In a real browser: the predicted error as a colour, and a session looked at again, in which nothing is asked.

What was known then is there again: landmarks in the scene and their residuals, and how the daemon was.
"""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pcmrs.testing.daemon import own_settings, serve_command
from tests.system.console.consoles import CHROMIUM, browser, console
from tests.system.console.test_browser import FACE, PATIENT, Operator, state

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]

RESIDUALS = re.compile("".join(rf"landmark_{n} \d\.\d\d mm.*" for n in range(1, len(FACE) + 1)), re.DOTALL)


def landmarks_in_scene(page: Page, count: int) -> None:
    """Waits until so many planned landmarks, and as many digitized ones, can be seen in the only scene."""
    page.wait_for_function(
        """count => {
            const scene = window[Object.keys(window).find((name) => name.startsWith("scene_c"))];
            const seen = [];
            scene.traverseVisible((each) => seen.push(each.name ?? ""));
            const many = (kind) => seen.filter((name) => name.startsWith(kind)).length;
            return many("landmark ") == count && many("digitized ") == count;
        }""",
        arg=count,
    )


def test_colours_and_a_replay(tmp_path: Path) -> None:
    overrides = [*own_settings(tmp_path / "cell", "seen"), *PATIENT, "recording.enabled=true"]
    with subprocess.Popen(serve_command(overrides), stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        ready = json.loads(daemon.stdout.readline())
        _, site, cell = ready["prefix"].split("/")
        address = ["--endpoint", ready["endpoint"], "--site", site, "--cell", cell]
        recordings = ["--recordings", str(Path(ready["folder"]) / "recordings")]
        with console(*address, *recordings) as (_, url), browser(url) as page:
            operator = Operator(page)
            operator.plan_landmarks()
            operator.press("digitization.digitize_all")
            operator.press("registration.register")
            operator.in_state("registration", "111")
            operator.expect(operator.at("landmark-residuals")).to_have_text(RESIDUALS)
            with page.expect_response("**/error/*.glb") as answer:
                operator.at("predicted-error").click()
            assert answer.value.body()[:4] == b"glTF"
            operator.shows("legend", "4.0 mm")
            operator.open("session")
            operator.shows("timeline", "registration.register: accepted")
            operator.at("filter").fill("plan_landmarks")
            operator.expect(operator.at("timeline")).not_to_contain_text("registration.register")
            operator.press("watch")
            operator.at("moment").wait_for()
            operator.in_state("registration", "000")
            operator.expect(operator.at("residual")).to_be_hidden()
            landmarks_in_scene(page, 0)
            box = operator.at("moment").bounding_box()
            assert box is not None
            page.mouse.click(box["x"] + box["width"] - 2, box["y"] + box["height"] / 2)
            operator.in_state("registration", "111")
            operator.expect(operator.at("landmark-residuals")).to_have_text(RESIDUALS)
            landmarks_in_scene(page, len(FACE))
            operator.open("signals")
            operator.expect(operator.at("health")).to_have_text(re.compile("ok|degraded"))
            operator.open("workflow")
            for button in page.locator("button[data-testid*='.']").all():
                operator.expect(button).to_be_disabled()
            assert state(address)["branches"]["registration"] == "111"
            page.keyboard.press("Escape")
            operator.expect(operator.at("latched")).to_be_visible()
            assert state(address)["latched"]
            operator.press("to-cell")
            operator.at("tab-planning").wait_for()
        daemon.terminate()
