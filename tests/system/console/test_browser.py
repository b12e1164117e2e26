"""The page in a real browser, on a real daemon: a procedure by clicking, and what may go wrong in it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pcmrs.console._meaning import SETTLING_TIME
from tests import ROOT
from tests.system.console.consoles import CHROMIUM, ask, browser, client_of, console, running_cell, to_registered_head
from tests.system.network.remote_cell import CELL, SITE, Loopback, remote_cell

pytest.importorskip("playwright")

if TYPE_CHECKING:
    from playwright.sync_api import FloatRect, Locator, Page

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]
PATIENT = (
    "procedure.max_pose_age=3", "robot.deadman=1.0", "sim.arm.physics=kinematic", "sim.digitization.reach_time=0.1",
)  # fmt: skip
"""A browser that renders without a graphics card takes most of this machine; nobody waits for the pointer."""
FACE = ((0.5, 0.45), (0.45, 0.35), (0.55, 0.35), (0.5, 0.65), (0.44, 0.55), (0.56, 0.55))
"""Where the head is clicked, parts of the picture's width and height."""
PLAN: dict[str, Any] = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())
HOLD_MS = 1_200
"""Time for which a button is held that moves the arm."""
CAMERA = "canvas => getElement(canvas.parentElement.id.slice(1)).camera.position.toArray()"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[str]]:
    """Options that reach a running cell, the same for all here."""
    with running_cell(tmp_path_factory.mktemp("cell"), *PATIENT) as options:
        yield options


@pytest.fixture
def at_rest(address: list[str]) -> list[str]:
    """The cell with its arm at rest and nothing planned, whatever it was used for before."""
    with client_of(address) as cell:
        if cell.state().branches["placement"] == "placed":
            ask(cell, "placement.back_off")
        if cell.state().branches["placement"] == "standoff":
            ask(cell, "placement.home")
        if cell.state().branches["robot"] == "1":
            ask(cell, "robot.disconnect")
        for operation in ("toolplan.clear", "registration.clear_landmarks"):
            ask(cell, operation)
    return address


def state(address: list[str]) -> dict[str, Any]:
    command = [sys.executable, "-m", "pcmrs.cli", "state", "--json", *address]
    shown: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    return shown


UNFOLDED = "() => ![...document.querySelectorAll('.q-expansion-item__content')].some(each => each.style.height)"


class Operator:
    """Whoever clicks."""

    def __init__(self, page: Page) -> None:
        from playwright.sync_api import expect

        self.page, self.expect = page, expect
        page.locator("canvas").first.wait_for()
        self.more()

    def at(self, name: str) -> Locator:
        return self.page.get_by_test_id(name)

    def press(self, name: str) -> None:
        self.expect(self.at(name)).to_be_enabled(timeout=60_000)
        self.strike(name, hold_ms=self.patience(name))

    def strike(self, name: str, *, hold_ms: int) -> None:
        self.at(name).click(delay=hold_ms)

    def patience(self, name: str) -> int:
        """Waits until a button of an operation has settled, and returns for how long it is to be held, ms."""
        if "." not in name and name not in ("next", "send-form", "move-now", "looked"):
            return 0
        self.page.wait_for_timeout(1000.0 * SETTLING_TIME + 200.0)
        return HOLD_MS if self.at(name).get_attribute("data-hold") is not None else 0

    def in_state(self, branch: str, state: str) -> None:
        self.expect(self.at(f"state-{branch}")).to_have_attribute("data-state", state, timeout=60_000)

    def more(self) -> None:
        """Opens what is offered besides the next step."""
        self.at("more").get_by_role("button").first.click()
        self.unfolded()

    def unfolded(self) -> None:
        """Waits until nothing is being unfolded, which would move what is pointed at."""
        self.page.wait_for_function(UNFOLDED)

    def shows(self, name: str, text: str) -> None:
        self.expect(self.at(name)).to_contain_text(text, timeout=60_000)

    def open(self, tab: str) -> None:
        self.at(f"tab-{tab}").click()

    def plan_landmarks(self) -> None:
        self.open("planning")
        canvas = self.at("planning").locator("canvas")
        canvas.wait_for()
        box = canvas.bounding_box()
        assert box is not None
        for number, (x, y) in enumerate(FACE, start=1):
            self.pick(canvas, {"x": x * box["width"], "y": y * box["height"]}, f"landmark_{number}:")
        self.orbit(canvas)
        self.press("send-landmarks")
        self.open("workflow")
        self.in_state("registration", "100")
        self.open("planning")
        self.expect(self.at("landmarks")).to_contain_text(f"landmark_{len(FACE)}:")
        self.expect(self.at("landmarks")).not_to_contain_text(f"landmark_{len(FACE) + 1}:")
        self.open("workflow")

    def orbit(self, canvas: Locator) -> None:
        """Turns a scene, and finds it turned."""
        box, before = canvas.bounding_box(), canvas.evaluate(CAMERA)
        assert box is not None
        self.drag(box, 60.0, 20.0)
        assert canvas.evaluate(CAMERA) != before

    def drag(self, box: FloatRect, dx: float, dy: float) -> None:
        """From the middle of a box."""
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + dx, y + dy, steps=4)
        self.page.mouse.up()

    def plan_tool(self) -> None:
        self.open("planning")
        self.choose_tool()
        self.at("tool-point").fill("4 -12 143")
        self.press("place-tool")
        self.shows("tool-pose", "4.0 -12.0 143.0")
        self.at("tool-pose").click()
        self.page.keyboard.press("ArrowUp")
        self.shows("tool-pose", "4.0 -11.0 143.0")
        self.press("send-tool")
        self.open("workflow")
        self.in_state("toolplan", "1")

    def choose_tool(self) -> None:
        self.at("mode").get_by_text("Tool pose").click()

    def touch(self, canvas: Locator, position: Any) -> None:
        canvas.click(position=position)

    def to_standoff(self) -> None:
        self.plan_landmarks()
        self.press("digitization.digitize_all")
        self.press("registration.register")
        self.in_state("registration", "111")
        self.plan_tool()
        self.press("robot.connect")
        self.in_state("placement", "retracted")

    def pick(self, canvas: Locator, position: Any, name: str) -> None:
        """The surface is loaded after its scene: what is clicked before that hits nothing."""
        for _ in range(20):
            self.touch(canvas, position)
            try:
                self.expect(self.at("landmarks")).to_contain_text(name, timeout=2_000)
            except AssertionError:
                continue
            return
        raise AssertionError(f"no {name}")


def test_a_procedure_by_clicking(at_rest: list[str]) -> None:
    with console(*at_rest) as (_, url), browser(url) as page:
        operator = Operator(page)
        operator.expect(operator.at("placement.approach")).to_be_disabled()
        operator.at("placement.approach").hover(force=True)
        operator.expect(page.get_by_role("tooltip")).to_contain_text("does not allow approach")
        operator.press("registration.use_previous")
        operator.shows("refused", "registration.use_previous: rejected")
        operator.to_standoff()
        operator.shows("residual", "mm")
        operator.press("placement.approach")
        operator.shows("running", "Approach")
        page.keyboard.press("Escape")
        operator.expect(operator.at("latched")).to_be_visible()
        operator.in_state("placement", "held")
        operator.expect(operator.at("placement.back_off")).to_be_disabled()
        operator.press("robot.acknowledge")
        operator.press("placement.back_off")
        operator.in_state("placement", "retracted")
        operator.press("placement.approach")
        operator.in_state("placement", "standoff")
        operator.press("placement.confirm")
        operator.in_state("placement", "placed")
        millimetres = float(operator.at("error").inner_text().split()[0])
        assert millimetres < 1.0
        operator.press("placement.back_off")
        operator.in_state("placement", "standoff")
        operator.press("placement.home")
        operator.in_state("placement", "retracted")
        operator.open("session")
        operator.shows("timeline", "placement.home: accepted")
        operator.open("signals")
        operator.shows("ages", "body_ref: ")
        page.get_by_role("tab", name="State chart").click()
        operator.expect(page.locator("#state-placement-retracted.current")).to_be_visible(timeout=60_000)
        page.get_by_text("de", exact=True).click()
        operator.shows("stop", "STOPP")


def test_a_procedure_by_the_next_step_alone(at_rest: list[str]) -> None:
    """Planning is done on the surface; everything else by the large button."""
    with console(*at_rest) as (_, url), browser(url) as page:
        operator = Operator(page)
        operator.shows("next", "Plan landmarks")
        operator.press("next")
        operator.plan_landmarks()
        operator.shows("next", "Plan")
        operator.press("next")
        operator.plan_tool()
        for number in range(1, len(FACE) + 1):
            operator.shows("next", f"Touch {number} of {len(FACE)}")
            operator.press("next")
        for label in ("Register", "Connect"):
            operator.shows("next", label)
            operator.press("next")
        for label in ("Approach", "Confirm"):
            operator.shows("next", label)
            operator.at("next").click()
            page.wait_for_timeout(500)
            assert state(at_rest)["running"] == [], "a click moves nothing"
            operator.press("next")
        operator.in_state("placement", "placed")
        page.keyboard.press("Escape")
        operator.shows("stop-report", "Stopped by bus:local")
        operator.shows("next", "Release Stop")
        operator.press("next")
        operator.expect(operator.at("latched")).to_be_hidden()


class Typist(Operator):
    """Whoever has no mouse."""

    def strike(self, name: str, *, hold_ms: int) -> None:
        self.at(name).press("Enter", delay=hold_ms)

    def open(self, tab: str) -> None:
        self.at(f"tab-{tab}").press("Enter")

    def plan_landmarks(self) -> None:
        self.open("planning")
        for landmark in PLAN["landmarks"]:
            self.at("landmark-name").fill(landmark["name"])
            self.at("landmark-point").fill(" ".join(f"{1000.0 * value:.3f}" for value in landmark["position"]))
            self.press("add-landmark")
            self.shows("landmarks", f"{landmark['name']}:")
        self.press("send-landmarks")
        self.open("workflow")
        self.in_state("registration", "100")

    def choose_tool(self) -> None:
        self.at("mode").get_by_role("button", name="Tool pose").press("Enter")


def test_a_procedure_by_keyboard(at_rest: list[str]) -> None:
    with console(*at_rest) as (_, url), browser(url) as page:
        typist = Typist(page)
        typist.to_standoff()
        typist.press("placement.approach")
        typist.shows("running", "Approach")
        page.keyboard.press("Escape")
        typist.in_state("placement", "held")
        for operation in ("robot.acknowledge", "placement.back_off"):
            typist.press(operation)
        typist.in_state("placement", "retracted")
        typist.press("placement.approach")
        typist.in_state("placement", "standoff")
        typist.press("placement.confirm")
        typist.in_state("placement", "placed")


def test_a_console_that_is_killed_in_motion_changes_nothing(at_rest: list[str]) -> None:
    with client_of(at_rest) as cell:
        to_registered_head(cell)
        with console(*at_rest) as (process, url), browser(url) as page:
            operator = Operator(page)
            operator.press("placement.approach")
            operator.shows("running", "Approach")
            process.kill()
            cell.until(lambda state: state.branches["placement"] == "standoff")
            assert not cell.state().latched
    with console(*at_rest) as (_, url), browser(url) as page:
        Operator(page).in_state("placement", "standoff")


def test_a_viewer_sees_all_and_commands_nothing(tmp_path: Path) -> None:
    network = Loopback()
    with remote_cell(network, tmp_path, *PATIENT) as cell:
        where = ("--endpoint", network.listen, "--site", SITE, "--cell", CELL)
        with console(*where, "--identity", str(tmp_path / "eve")) as (_, url), browser(url) as page:
            viewer = Operator(page)
            viewer.shows("signed-in", "eve (viewer)")
            viewer.in_state("registration", "000")
            buttons = page.locator("button[data-testid*='.']")
            viewer.expect(buttons.first).to_be_visible()
            assert buttons.count() > 30
            viewer.expect(page.locator("button[data-testid*='.']:enabled")).to_have_count(0)
            assert cell.on_site()["branches"]["registration"] == "000"
            beside = ("--endpoint", f"tcp/127.0.0.1:{(tmp_path / 'port').read_text()}", "--site", SITE, "--cell", CELL)
            assert page.context.browser is not None
            with console(*beside) as (_, other):
                second = page.context.browser.new_page()
                second.goto(other)
                operator = Operator(second)
                operator.press("hold")
                viewer.shows("lease", "local holds the cell")
                operator.press("registration.use_previous")
                viewer.shows("refused", "registration.use_previous: rejected")
            page.keyboard.press("Escape")
            viewer.expect(viewer.at("latched")).to_be_visible()
