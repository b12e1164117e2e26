"""The health of the daemon on the page: as it reports it, and "not known" for what it does not."""

from __future__ import annotations

from msgspec.structs import replace

from pcmrs.console.signals._health_panel import HealthPanel
from pcmrs.service.health.report import report
from tests.support.health_facts import WELL
from tests.unit.console.detached_page import ENGLISH, DetachedPage


def rows(page: DetachedPage) -> dict[str, str]:
    return {row["what"]: row["value"] for row in page.at("counters").rows}


def test_without_a_daemon_nothing_is_known(page: DetachedPage) -> None:
    panel = HealthPanel(ENGLISH)
    panel.draw(report(WELL))
    panel.draw(None)
    assert page.text("health") == "Daemon: not known"
    assert rows(page) == {}


def test_ages_are_ms_and_unknown_ones_say_so(page: DetachedPage) -> None:
    HealthPanel(ENGLISH).draw(report(WELL))
    assert page.text("health") == "Daemon: ok"
    found = rows(page)
    assert "20" in found["robot"]
    assert "beats 3" in found["robot"]
    assert found["emg"].count("not known") == 2
    assert (found["bus"], found["journal"]) == ("2/256", "1/4096"), "depth and limit"
    assert found["bus.replaced"] == "8"


def test_each_reason_is_shown_with_its_remedy(page: DetachedPage) -> None:
    panel = HealthPanel(ENGLISH)
    panel.draw(report(replace(WELL, metrics="Port 9 is taken.")))
    assert any("Port 9 is taken." in text and "Give another" in text for text in page.everything)
    panel.draw(report(WELL))
    assert not any("Port 9" in text for text in page.everything), "it is gone when the problem is"
