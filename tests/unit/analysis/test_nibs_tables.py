"""Tables of the stimulation: every column is described, and their links lead on."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pcmrs.analysis.mep_table import MEPS, write_meps
from pcmrs.analysis.nibs_tables import EVENTS, MARKERS, PARAMETERS, write_nibs
from tests.support.session_records import nothing, record
from tests.unit.analysis.tables import STEM, rows, sidecar

TEXT = {
    "nibs_event_id",
    "nibs_position_id",
    "nibs_type",
    "stimulator_id",
    "nibs_element_id",
    "stimulus_shape",
    "trial_type",
    "pulse",
    "muscle",
    "status",
    "intensity_reference",
    "intensity_scaling",
    "status_description",
    "position_group",
    "position_label",
    "response",
    "preactivated",
    "saturated",
    "artefact",
}
"""Columns without a unit; all others are numbers that need one. Components of unit vectors have none."""


@pytest.mark.parametrize("name", ["nibs", "events", "markers", "mep"])
def test_every_column_is_described_in_order(nibs: Path, emg: Path, name: str) -> None:
    path = (emg if name == "mep" else nibs) / f"{STEM}_{name}.tsv"
    header = path.read_text().splitlines()[0].split("\t")
    names = {
        "nibs": [column.name for column in PARAMETERS],
        "events": [column.name for column in EVENTS],
        "markers": [column.name for column in MARKERS],
        "mep": [column.name for column in MEPS],
    }
    assert header == names[name]
    described = sidecar(path)
    assert [key for key in described if key in header] == header
    for column in header:
        assert described[column]["Description"]
        unitless = column in TEXT or column.startswith(("position_normal", "position_direction"))
        assert ("Units" in described[column]) != unitless


def test_first_columns_are_those_that_the_standards_want(nibs: Path) -> None:
    first = {name: (nibs / f"{STEM}_{name}.tsv").read_text().split("\t")[:2] for name in ("nibs", "events", "markers")}
    assert first["nibs"][0] == "nibs_event_id"
    assert first["events"] == ["onset", "duration"]
    assert first["markers"][0] == "nibs_position_id"


def test_links_lead_on(nibs: Path, emg: Path) -> None:
    sets, positions = rows(nibs / f"{STEM}_nibs.tsv"), rows(nibs / f"{STEM}_markers.tsv")
    ids, places = [row["nibs_event_id"] for row in sets], [row["nibs_position_id"] for row in positions]
    assert len(set(ids)) == len(ids)
    assert len(set(places)) == len(places)
    for row in rows(nibs / f"{STEM}_events.tsv") + rows(emg / f"{STEM}_mep.tsv"):
        assert row["nibs_event_id"] in ids
        assert row["nibs_position_id"] in places
    about = sidecar(nibs / f"{STEM}_nibs.tsv")
    assert {row["stimulator_id"] for row in sets} == {each["StimulatorID"] for each in about["StimulatorSet"]}
    elements = {each["ElementID"] for each in about["ElementSet"]}
    assert {row["nibs_element_id"] for row in sets + positions} == elements
    assert about["IntendedFor"] == f"bids::sub-phantom7/nibs/{STEM}_events.tsv"


def test_each_set_of_parameters_is_there_once(nibs: Path) -> None:
    intensities = [float(row["stimulus_intensity"]) for row in rows(nibs / f"{STEM}_nibs.tsv")]
    assert intensities == sorted({pulse.intensity for pulse in record().pulses})


def test_the_threshold_is_a_reference_of_intensities(nibs: Path) -> None:
    (found,) = sidecar(nibs / f"{STEM}_nibs.tsv")["IntensitySet"]
    threshold = record().threshold
    assert threshold is not None
    assert (found["IntensityID"], found["Value"]) == ("rMT", threshold.threshold)


def test_axes_of_the_coil_are_unit_vectors(nibs: Path) -> None:
    for row in rows(nibs / f"{STEM}_markers.tsv"):
        normal, direction = (
            [float(row[f"position_{name}_{axis}"]) for axis in "xyz"] for name in ("normal", "direction")
        )
        assert math.hypot(*normal) == pytest.approx(1.0, abs=1e-5)
        assert np.dot(normal, direction) == pytest.approx(0.0, abs=1e-5)
        assert normal[2] > 0.0  # away from the head, whose hand area looks upwards


def test_landmarks_are_in_the_coordinate_system(nibs: Path) -> None:
    system = json.loads((nibs / f"{STEM}_coordsystem.json").read_text())
    assert system["NIBSCoordinateUnits"] == "mm"
    assert system["AnatomicalLandmarkCoordinates"]["nasion"] == [4.0, 86.0, 40.0]
    assert system["AnatomicalLandmarkRmsDeviation"] == {"RMS": [1.91], "nasion": [1.11], "left_tragus": [2.22]}


def test_a_dataset_says_that_it_is_simulated(nibs: Path) -> None:
    description = json.loads((nibs.parents[1] / "dataset_description.json").read_text())
    assert description["Name"].startswith("Simulated")
    assert description["GeneratedBy"][0]["Version"] == "9.8.7"


def test_validators_are_told_what_is_not_part_of_bids(nibs: Path, emg: Path) -> None:
    assert (nibs.parents[1] / ".bidsignore").read_text() == "nibs/\n"
    assert (emg.parents[1] / ".bidsignore").read_text() == "emg/\n"


def test_a_session_without_pulses_has_tables_without_rows(tmp_path: Path) -> None:
    write_nibs(nothing(), tmp_path)
    write_meps(nothing(), tmp_path / "derivatives")
    for path in tmp_path.rglob("*.tsv*"):
        if path.name != "participants.tsv":
            assert rows(path) == []
