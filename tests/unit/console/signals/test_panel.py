"""The tab of signals remembers while it is closed, and is drawn only while it is open."""

from __future__ import annotations

from nicegui import ui

from pcmrs.console.signals.panel import SignalsPanel
from pcmrs.service.health.report import report
from pcmrs.spatial import Transform
from tests.support.health_facts import WELL
from tests.unit.console.detached_page import ENGLISH, DetachedPage, ShownCell
from tests.unit.console.shown_cell import body, setup


async def test_a_closed_tab_is_not_drawn_but_misses_nothing(page: DetachedPage) -> None:
    view, is_open = ShownCell(), False
    view.health = report(WELL)
    with page.client:
        SignalsPanel(view, setup(), ENGLISH, lambda: is_open)
    for view.now in range(3):
        view.poses["body_ref"] = body("body_ref", Transform.identity())
        await page.tick()
    assert page.text("health") == ""
    is_open = True
    await page.tick()
    assert page.text("health") == "Daemon: ok"
    _, motion, *_ = [each for each in page.client.elements.values() if isinstance(each, ui.echart)]
    assert len(motion.options["series"][0]["data"]) == 4, "the moments before it was opened"
