"""Figures of a report: drawn from what there is, the same bytes each time, with names as they are."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import msgspec
import pytest

from pcmrs.report._contents import ReportedEvent, SessionReport
from pcmrs.report.figures import draw_figures
from pcmrs.report.reading import read_report
from tests.unit.replay.golden import WORKFLOWS
from tests.unit.report.report_journals import golden_rows, write_journal


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> SessionReport:
    """The first run of the golden session, with a registration and placements in it."""
    return read_report(write_journal(golden_rows("ratms")[:125], tmp_path_factory.mktemp("cell") / "j.sqlite"))


def texts(drawing: bytes) -> str:
    """The labels of a figure: matplotlib draws letters, and names them in comments."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(drawing, parser)
    return "\n".join(node.text or "" for node in root.iter(ElementTree.Comment))  # type: ignore[arg-type]


def test_figures_are_drawn_twice_with_the_same_bytes(report: SessionReport) -> None:
    first, again = draw_figures(report), draw_figures(report)
    assert first == again
    assert set(first) == {"timeline", "landmarks", "errors", "placements"}


@pytest.mark.nightly
@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_figures_of_a_golden_journal_are_drawn(workflow: str, tmp_path: Path) -> None:
    drawn = draw_figures(read_report(write_journal(golden_rows(workflow), tmp_path / "j.sqlite")))
    assert set(drawn) == {"timeline", "landmarks", "errors", "placements"}


def test_only_what_there_is_is_drawn(report: SessionReport) -> None:
    without = msgspec.structs.replace(report, registrations=(), placements=())
    assert set(draw_figures(without)) == {"timeline"}
    unmeasured = tuple(msgspec.structs.replace(each, axes_mm=None) for each in report.placements)
    assert set(draw_figures(msgspec.structs.replace(report, placements=unmeasured))) == {"timeline", "landmarks"}
    assert draw_figures(msgspec.structs.replace(without, branches=())) == {}


def test_landmarks_are_named_as_in_the_plan_also_with_a_dollar(report: SessionReport) -> None:
    last = report.registrations[-1]
    landmarks = (msgspec.structs.replace(last.landmarks[0], name="point $x_{"), *last.landmarks[1:])
    renamed = msgspec.structs.replace(last, landmarks=landmarks)
    said = texts(draw_figures(msgspec.structs.replace(report, registrations=(renamed,), placements=()))["landmarks"])
    assert "point $x {" in said
    assert f"mean {last.residual_mm:.2f} mm" in said
    for landmark in last.landmarks[1:]:
        assert landmark.name.replace("_", " ") in said


def test_stops_and_faults_are_explained_where_there_are_any(report: SessionReport) -> None:
    event = ReportedEvent(sequence=1, wall=report.begun + 1.0, kind="stop", source="robot", code="x", text="", times=1)
    fault = msgspec.structs.replace(event, kind="fault")
    cases: list[tuple[list[ReportedEvent], set[str]]] = [([], set()), ([event], {"Stop"}), ([fault], {"fault"})]
    for events, labels in cases:
        timeline = msgspec.structs.replace(
            report, events=tuple(events), runs=report.runs[:1], registrations=(), placements=()
        )
        assert {"Stop", "fault"} & set(texts(draw_figures(timeline)["timeline"]).split()) == labels
