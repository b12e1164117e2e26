"""The table of the hot-spot experiment: what more than half of the searches never reach is never, not a number."""

from __future__ import annotations

from pcmrs_lab.cli.hotspot_tables import hotspot_table
from pcmrs_lab.experiment.hotspots import HotspotReport, HotspotResult, SubjectQuantiles
from tests.unit.lab.cli.shown import line_of, shown


def test_a_search_that_is_never_near_is_reported_as_never() -> None:
    pulses = SubjectQuantiles(24.0, 40.0)
    result = HotspotResult(
        method="adaptive",
        near=0.495,
        pulses_until_near=SubjectQuantiles(None, None),
        pulses=pulses,
        error_mm=SubjectQuantiles(2.5, 7.25),
        heading_error_deg=SubjectQuantiles(4.04, 12.0),
        uncertainty_mm=SubjectQuantiles(1.5, 3.0),
        unanswered=2,
    )
    report = HotspotReport("hotspots", 1, 200, True, 120.0, SubjectQuantiles(11.0, 19.5), [result])
    table = hotspot_table(report)
    numbers = ["never", "never", "24", "40", "2.50", "7.25", "4.0", "12.0", "1.50", "2"]
    assert line_of(table, "adaptive") == ["adaptive", "49.5", "%", *numbers]
    text = " ".join(shown(table).split())
    assert "Pulses at 120 % of the subject's threshold" in text
    assert "11.0 mm from the hot-spot in the median (p95 19.5 mm)" in text
