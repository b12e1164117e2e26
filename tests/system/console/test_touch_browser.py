"""The page on a tablet, by fingers only: lying and upright, nothing cut off or too small, Stop always at hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.system.console.consoles import CHROMIUM, browser, console, running_cell
from tests.system.console.test_browser import PATIENT, Operator

pytest.importorskip("playwright")

if TYPE_CHECKING:
    from playwright.sync_api import FloatRect, Locator, ViewportSize

pytestmark = [
    pytest.mark.browser,
    pytest.mark.nightly,
    pytest.mark.timeout(400),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]
LYING: ViewportSize = {"width": 1024, "height": 768}
UPRIGHT: ViewportSize = {"width": 768, "height": 1024}
TABLET = "Mozilla/5.0 (Linux; Android 14; SM-X510) AppleWebKit/537.36 Chrome/140.0.0.0 Safari/537.36"
TABS = ("workflow", "planning", "signals", "session")
FLAWS = """() => {
    const least = 43.9, found = [];
    const inside = (r, of) =>
        r.left >= of.left - 1 && r.right <= of.right + 1 && r.top >= of.top - 1 && r.bottom <= of.bottom + 1;
    const touched = (r, x, y) => document.elementFromPoint(r.left + x * r.width, r.top + y * r.height);
    const check = (element, name) => {
        element.scrollIntoView({block: "nearest", inline: "nearest"});
        const r = element.getBoundingClientRect();
        if (!inside(r, {left: 0, top: 0, right: innerWidth, bottom: innerHeight})) found.push(name + " is cut off");
        if (r.width < least || r.height < least) found.push(`${name} has ${r.width} x ${r.height} px`);
        for (const [x, y] of [[0.5, 0.5], [0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]]) {
            const at = touched(r, x, y);
            if (!element.contains(at) && at !== element.closest(".asking"))
                found.push(`${name} is covered by ${at?.outerHTML.slice(0, 80)}`);
        }
    };
    const stop = document.querySelector("[data-testid=stop]");
    for (const each of document.querySelectorAll("button, .q-tab, .q-checkbox, .q-field, .q-expansion-item .q-item")) {
        if (!each.checkVisibility()) continue;
        check(each, each.dataset.testid ?? each.textContent);
        check(stop, "Stop");
    }
    for (const each of document.querySelectorAll(".halves *"))
        if (each.scrollLeft > 0) found.push(`${each.className} has to be moved sideways`);
    const head = document.querySelector(".head");
    for (const each of head.querySelectorAll("*"))
        if (!inside(each.getBoundingClientRect(), head.getBoundingClientRect()))
            found.push(`${each.textContent} is cut off`);
    return [...new Set(found)];
}"""


class Finger(Operator):
    """Whoever taps and drags."""

    def strike(self, name: str, *, hold_ms: int) -> None:
        assert not hold_ms, "Playwright's finger cannot be held"
        self.at(name).tap()

    def more(self) -> None:
        self.at("more").get_by_role("button").first.tap()
        self.unfolded()

    def open(self, tab: str) -> None:
        self.at(f"tab-{tab}").tap()
        self.expect(self.at(f"tab-{tab}")).to_have_attribute("aria-selected", "true")

    def touch(self, canvas: Locator, position: Any) -> None:
        canvas.tap(position=position)

    def drag(self, box: FloatRect, dx: float, dy: float) -> None:
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        touch = self.page.context.new_cdp_session(self.page)
        touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
        for part in (0.25, 0.5, 0.75, 1.0):
            point = {"x": x + part * dx, "y": y + part * dy}
            touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [point]})
        self.page.wait_for_timeout(200)  # a finger that does not rest flings, and the next tap would end that only
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    def finds_no_flaw(self) -> None:
        for tab in TABS:
            self.open(tab)
            self.unfolded()
            assert self.page.evaluate(FLAWS) == []
        self.open("planning")
        self.choose_tool()
        assert self.page.evaluate(FLAWS) == []
        self.at("mode").get_by_text("Landmarks").tap()

    def choose_tool(self) -> None:
        self.at("mode").get_by_text("Tool pose").tap()


def test_a_tablet_lying_and_upright(tmp_path: Path) -> None:
    tablet = {"viewport": LYING, "has_touch": True, "is_mobile": True, "user_agent": TABLET}
    with running_cell(tmp_path, *PATIENT) as address, console(*address) as (_, url), browser(url, **tablet) as page:
        finger = Finger(page)
        finger.in_state("registration", "000")
        finger.finds_no_flaw()
        page.get_by_role("tab", name="State chart").tap()
        page.set_viewport_size(UPRIGHT)
        finger.finds_no_flaw()
        page.get_by_role("tab", name="Scene").tap()
        scene = page.get_by_label("Scene", exact=True).locator("canvas")
        box = scene.bounding_box()
        assert box is not None
        assert box["width"] == UPRIGHT["width"]
        finger.orbit(scene)

        finger.open("workflow")
        finger.at("placement.approach").tap(force=True)
        finger.expect(page.get_by_role("alert")).to_contain_text("does not allow approach")
        finger.press("registration.use_previous")
        finger.shows("refused", "registration.use_previous: rejected")
        finger.press("robot.connect")
        finger.in_state("robot", "1")

        finger.plan_landmarks()

        finger.press("stop")
        finger.expect(finger.at("latched")).to_be_visible()
        finger.expect(page.locator(".q-notification")).to_have_count(0, timeout=60_000)
        assert page.evaluate(FLAWS) == []
        finger.open("workflow")
        finger.press("robot.acknowledge")
        finger.expect(finger.at("latched")).to_be_hidden()
