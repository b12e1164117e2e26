"""Tables of a session: they read back as what they were made from, keep the rules of BIDS, and their links lead on."""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.analysis.bids import MISSING, cell, label
from pcmrs.analysis.mep_table import MEPS, write_meps
from pcmrs.analysis.nibs_tables import EVENTS, MARKERS, PARAMETERS, write_nibs
from tests.support.session_records import nothing, record

STEM = "sub-phantom7_task-rmt"
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


def rows(path: Path) -> list[dict[str, str]]:
    raw = path.read_bytes()
    text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode()
    return list(csv.DictReader(io.StringIO(text), delimiter="\t", quoting=csv.QUOTE_NONE))


def sidecar(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.with_name(path.name.split(".")[0] + ".json").read_text())
    return found


@pytest.fixture(scope="module")
def nibs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dataset = tmp_path_factory.mktemp("raw")
    write_nibs(record(), dataset)
    return dataset / "sub-phantom7" / "nibs"


@pytest.fixture(scope="module")
def emg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dataset = tmp_path_factory.mktemp("derived")
    write_meps(record(), dataset)
    return dataset / "sub-phantom7" / "emg"


def test_responses_read_back(emg: Path) -> None:
    for row, pulse in zip(rows(emg / f"{STEM}_mep.tsv"), record().pulses, strict=True):
        assert (int(row["pulse"]), float(row["stimulus_intensity"])) == (pulse.pulse, pulse.intensity)
        assert row["trial_type"] == pulse.phase
        assert float(row["onset"]) == pytest.approx(pulse.onset)
        if pulse.mep is not None:
            assert float(row["amplitude"]) == pytest.approx(1e6 * pulse.mep.peak_to_peak, rel=1e-6)
            assert row["response"] == str(pulse.mep.present).lower()
            assert row["latency"] == MISSING or float(row["latency"]) == pytest.approx(1e3 * (pulse.mep.latency or 0.0))


def test_missing_values_are_marked_with_their_reason(emg: Path) -> None:
    second, third = rows(emg / f"{STEM}_mep.tsv")[1:3]
    assert (second["status"], second["status_description"]) == ("bad", "The muscle was active before the pulse.")
    assert third["status_description"] == "No marker of pulse 3 was seen."
    assert {third[name] for name in ("amplitude", "latency", "baseline_rms", "response", "muscle")} == {MISSING}
    assert all(value for row in rows(emg / f"{STEM}_mep.tsv") for value in row.values())


def test_signals_read_back(emg: Path) -> None:
    samples = rows(emg / f"{STEM}_epochs.tsv.gz")
    for pulse in record().pulses:
        of_pulse = [row for row in samples if int(row["pulse"]) == pulse.pulse]
        expected = [] if pulse.epoch is None else pulse.epoch.samples
        assert np.allclose([1e-6 * float(row["emg"]) for row in of_pulse], expected, atol=1e-9)
    assert float(samples[0]["time"]) == pytest.approx(-0.12)


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


def test_a_session_without_pulses_has_tables_without_rows(tmp_path: Path) -> None:
    write_nibs(nothing(), tmp_path)
    write_meps(nothing(), tmp_path / "derivatives")
    for path in tmp_path.rglob("*.tsv*"):
        if path.name != "participants.tsv":
            assert rows(path) == []


@given(st.text())
def test_text_stays_in_its_cell(text: str) -> None:
    written = cell(text)
    assert written
    assert len(written.splitlines()) == 1
    assert "\t" not in written


@pytest.mark.parametrize(
    ("value", "written"),
    [(None, "n/a"), (math.nan, "n/a"), (math.inf, "n/a"), (True, "true"), (0, "0"), (1.0, "1"), (0.1 + 0.2, "0.3")],
)
def test_values_are_written_as_bids_has_them(value: object, written: str) -> None:
    assert cell(value) == written


@given(st.text())
def test_labels_are_letters_and_digits(text: str) -> None:
    assert label(text).isascii()
    assert label(text).isalnum()
