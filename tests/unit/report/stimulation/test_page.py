"""The page of a session with stimulation holds every number it should, and needs nothing from outside."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import pytest

from pcmrs.analysis.session import SessionRecord
from pcmrs.report.pages import fixed
from pcmrs.report.stimulation.figures import draw_figures
from pcmrs.report.stimulation.page import minutes, plain, render_report
from tests.support.session_records import nothing, record, sparse_mesh

PICTURES = {"hotspot", "hunt", "responses", "waveforms", "placements"}
VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Text of a page, its elements, and whether they are closed in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def page(of: SessionRecord) -> Page:
    return Page(render_report(of, {}))


def test_every_number_is_there() -> None:
    full = record()
    assert full.threshold is not None
    assert full.hotspot is not None
    assert full.threshold.low is not None
    assert full.threshold.high is not None
    text = page(full).text
    place = ", ".join(
        f"{axis} {fixed(1e3 * value, 1)}"
        for axis, value in zip("xyz", full.hotspot.image_from_coil.position, strict=True)
    )
    for expected in (
        f"{plain(full.threshold.threshold)} %",
        f"{plain(full.threshold.low)} to {plain(full.threshold.high)} %",
        place,
        f"{1e3 * full.hotspot.uncertainty:.1f} mm rms",
        "1.84 mm",  # residual
        "1.91 mm",
        "1.32 mm rms at centroid",
        "2.57 mm at the pose planned last",
        "0.042 ± 0.016 mm, at most 0.053 mm",
        "nasion 1.11",
        "left tragus 2.22",
        "90 % of the maximum stimulator output, set by Dr Hand",
        "seed 7, run 5 times as fast",
        "50.00 % at the true hot-spot, 51.50 % at the pose of the hunt",
        "ratms_threshold 1.0.0",
        "ab" * 32,
        "pcmrs 9.8.7",
        "cell.rate=5",
        "12:05 min of the cell",
        "not a medical device",
    ):
        assert expected in text


def test_every_pulse_and_every_refusal_has_a_row() -> None:
    full = record()
    shown = page(full)
    for pulse in full.pulses:
        amplitude = "–" if pulse.mep is None else f"{1e6 * pulse.mep.peak_to_peak:.0f}"
        assert re.search(
            rf"\b{pulse.pulse} {minutes(pulse.onset)} {pulse.phase} {pulse.intensity:g} 0.12 0.04.? {amplitude} ",
            shown.text,
        )
    assert "No marker of pulse 3 was seen." in shown.text
    assert "hotspot.pulse bus:local 4 rejected not_aligned The coil is 2 mm < 3 mm & moving." in shown.text
    assert sum(name == "tr" and given.get("class") == "bad" for name, given in shown.elements) == 2


def test_markup_in_a_record_is_shown_as_text() -> None:
    evil = '<script>alert("1")</script>'
    altered = msgspec.structs.replace(
        record(),
        subject=evil,
        ended=evil,
        settings=(evil,),
        refusals=(msgspec.structs.replace(record().refusals[0], text=evil),),
    )
    shown = page(altered)
    assert "script" not in {name for name, _ in shown.elements}
    assert shown.text.count(evil) >= 4


def test_it_needs_nothing_from_outside(tmp_path: Path) -> None:
    shown = Page(render_report(record(), draw_figures(record(), sparse_mesh(), tmp_path)))
    sources = [given[key] for _, given in shown.elements for key in ("src", "href") if key in given]
    assert len(sources) == len(PICTURES)
    assert all(source is not None and source.startswith("data:image/") for source in sources)
    assert "script" not in {name for name, _ in shown.elements}
    assert not re.search(r"https?:|@import|url\(", render_report(record(), {}))


def test_it_says_first_what_is_simulated() -> None:
    assert page(record()).text.index("Simulated.") < page(record()).text.index("Motor threshold ")
    real = page(msgspec.structs.replace(record(), seed=None, truth=None)).text
    assert "Not simulated." in real
    assert "nobody was stimulated" not in real
    assert "Truth" not in real


def test_it_says_that_a_session_is_incomplete() -> None:
    assert "Incomplete. The session ended early: it was interrupted." in page(nothing()).text
    assert "Incomplete" not in page(record()).text


def test_nothing_is_a_report_too(tmp_path: Path) -> None:
    assert draw_figures(nothing(), sparse_mesh(), tmp_path) == {}
    text = page(nothing()).text
    for expected in (
        "not registered",
        "No hot-spot was searched for.",
        "No threshold was hunted.",
        "No pulse was given.",
    ):
        assert expected in text


@pytest.mark.parametrize(("value", "shown"), [(69.25, "69.25"), (70.0, "70"), (None, "–"), (-1.5, "−1.5")])
def test_numbers_are_as_long_as_they_need_be(value: float | None, shown: str) -> None:
    assert plain(value) == shown
