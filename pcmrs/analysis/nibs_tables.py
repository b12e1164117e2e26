"""Tables of the stimulation: the files of the NIBS-BIDS proposal (BEP037), version 6.3.

``*_nibs.tsv`` has one row for each set of parameters, ``*_events.tsv`` one for each pulse, ``*_markers.tsv`` one for
each position, and ``*_coordsystem.json`` describes the coordinates. The proposal is not part of BIDS yet.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcmrs.analysis._bids import VERSION, Column, label, write_ignored, write_json, write_table
from pcmrs.analysis.session import PulseRecord, SessionRecord
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats
from pcmrs.tms.scalp import as_transform

__all__ = ["write_nibs"]

TASK = "rmt"
PERCENT = "% Maximum Stimulator Output"
STIMULATOR, COIL = "stimulator", "coil"
PHASES = {
    "intensity": "over the hand area, to find an intensity for the search",
    "hotspot": "in the search of the motor hot-spot",
    "threshold": "in the hunt for the motor threshold",
}
ALGORITHMS = {"ml": "maximum likelihood", "relative_frequency": "relative frequency, 5 of 10"}


@dataclass(frozen=True)
class Position:
    """A row of the markers: a pose, ``image_from_coil``, and its purpose."""

    id: str
    group: str
    pose: PoseMessage
    label: str | None = None


def subject_label(record: SessionRecord) -> str:
    """Return the subject's label in file names; each seed of a simulation is another subject."""
    return label(record.subject) + ("" if record.seed is None else str(record.seed))


def event_id(pulse: PulseRecord) -> str:
    """Return the id of a pulse's set of parameters: single pulses differ in their intensity only."""
    return f"single-{pulse.intensity:g}"


def position_id(pulse: PulseRecord) -> str:
    """Return the id of the coil's position at a pulse."""
    return f"pulse-{pulse.pulse:03d}"


EVENTS: tuple[Column[PulseRecord], ...] = (
    Column("onset", "Of the pulse since the session began", lambda pulse: round(pulse.onset, 3), "s"),
    Column("duration", "A pulse has none that matters here", lambda _: None, "s"),
    Column("trial_type", "What the pulse was given for", lambda pulse: pulse.phase, levels=PHASES),
    Column("nibs_event_id", "Set of parameters in *_nibs.tsv", event_id),
    Column("nibs_position_id", "Position of the coil in *_markers.tsv", position_id),
    Column("pulse", "Number of the pulse, as the stimulator counted it", lambda pulse: pulse.pulse),
)

PARAMETERS: tuple[Column[PulseRecord], ...] = (
    Column("nibs_event_id", "Set of parameters; referred to by *_events.tsv", event_id),
    Column("nibs_type", "Modality", lambda _: "TMS", levels={"TMS": "Transcranial magnetic stimulation"}),
    Column("stimulator_id", "Device; see StimulatorSet", lambda _: STIMULATOR),
    Column("nibs_element_id", "Coil; see ElementSet", lambda _: COIL),
    Column("stimulus_shape", "Of the pulse; not known to this software", lambda _: None),
    Column("stimulus_intensity", "Of the single pulse", lambda pulse: pulse.intensity, PERCENT),
    Column("intensity_reference", "The intensity was chosen directly, not from a threshold", lambda _: "absolute"),
    Column("intensity_scaling", "Likewise", lambda _: "absolute"),
)


def _axis(name: str, what: str, index: int) -> list[Column[Position]]:
    """Return the three columns of one axis of the coil."""

    def component(number: int) -> Column[Position]:
        def value(position: Position) -> float:
            rotation: Floats = as_transform(position.pose).rotation
            return float(rotation[number, index])

        return Column(f"position_{name}_{'xyz'[number]}", f"{what}, {'xyz'[number]}: of a unit vector", value)

    return [component(number) for number in range(3)]


def _place(number: int) -> Column[Position]:
    text = f"Middle of the coil's face, {'xyz'[number]}"
    return Column(f"position_coil_{'xyz'[number]}", text, lambda each: 1e3 * each.pose.position[number], "mm")


MARKERS: tuple[Column[Position], ...] = (
    Column("nibs_position_id", "Position; referred to by *_events.tsv", lambda each: each.id),
    Column("nibs_element_id", "Coil; see ElementSet in *_nibs.json", lambda _: COIL),
    Column("position_group", "What the position was measured or found for", lambda each: each.group),
    Column("position_label", "Site", lambda each: each.label),
    *(_place(number) for number in range(3)),
    *_axis("normal", "Away from the head, along the coil's +z", 2),
    *_axis("direction", "Away from the handle, along the coil's +y", 1),
)


def write_nibs(record: SessionRecord, dataset: Path) -> None:
    """Write the files of the proposal.

    Args:
        record: The session.
        dataset: Folder of the dataset.
    """
    name = f"sub-{subject_label(record)}"
    stem = f"{name}_task-{TASK}"
    folder = dataset / name / "nibs"
    write_json(dataset / "dataset_description.json", description(record, "raw"))
    write_ignored(dataset, "nibs/")
    (dataset / "participants.tsv").write_text(f"participant_id\n{name}\n")
    sets = {event_id(pulse): pulse for pulse in sorted(record.pulses, key=lambda each: each.intensity)}
    about = _about(record, f"bids::{name}/nibs/{stem}_events.tsv")
    write_table(folder / f"{stem}_nibs.tsv", PARAMETERS, sets.values(), **about)
    write_table(folder / f"{stem}_events.tsv", EVENTS, record.pulses)
    write_table(folder / f"{stem}_markers.tsv", MARKERS, _positions(record))
    write_json(folder / f"{stem}_coordsystem.json", coordinate_system(record))


def description(record: SessionRecord, kind: str) -> dict[str, Any]:
    """Return the content of ``dataset_description.json``; its name starts with "Simulated" if it was.

    Args:
        record: The session.
        kind: Type of the dataset: ``raw`` or ``derivative``.
    """
    simulated = "Simulated: " if record.simulated else ""
    return {
        "Name": f"{simulated}motor hot-spot and motor threshold by robotic TMS",
        "BIDSVersion": VERSION,
        "DatasetType": kind,
        "GeneratedBy": [{"Name": "PCMRS", "Version": record.versions.get("pcmrs", "unknown")}],
    }


def coordinate_system(record: SessionRecord) -> dict[str, Any]:
    """Return the content of ``*_coordsystem.json``: coordinates of positions, and registration of the head."""
    text = "The image that was planned in: x to the right, y to the front, z up (RAS). "
    text += "The body was registered to it by anatomical landmarks; the tracker measured the coil."
    system: dict[str, Any] = {
        "NIBSCoordinateSystem": "Other",
        "NIBSCoordinateUnits": "mm",
        "NIBSCoordinateSystemDescription": text,
    }
    registration = record.registration
    if registration is None:
        return system
    deviations = zip(registration.landmarks, registration.distances_mm, strict=False)
    return system | {
        "AnatomicalLandmarkCoordinates": {
            name: [round(1e3 * value, 3) for value in place] for name, place in registration.landmarks.items()
        },
        "AnatomicalLandmarkCoordinateSystem": "Other",
        "AnatomicalLandmarkCoordinateUnits": "mm",
        "AnatomicalLandmarkCoordinateSystemDescription": "As NIBSCoordinateSystem.",
        "AnatomicalLandmarkCoordinatesDescription": "As they were planned in the image.",
        "AnatomicalLandmarkRmsDeviation": {
            "RMS": [round(registration.rms_mm, 3)],
            **{name: [round(distance, 3)] for name, distance in deviations},
        },
        "AnatomicalLandmarkRmsDeviationUnits": "mm",
        "AnatomicalLandmarkRmsDeviationDescription": "Distance of each digitized landmark from the planned one after "
        "the rigid registration; RMS: root mean square over them.",
    }


def _about(record: SessionRecord, timeline: str) -> dict[str, Any]:
    """Return the fields of ``*_nibs.json`` before its columns."""
    device = "simulated" if record.simulated else "unknown"
    return {
        "TaskName": TASK,
        "TaskDescription": "Resting motor threshold at the motor hot-spot",
        "NIBSDescription": "Single pulses: an intensity, the motor hot-spot, the resting motor threshold.",
        "ConcurrentModalities": ["emg"],
        "IntendedFor": timeline,
        "StimulatorSet": [{"StimulatorID": STIMULATOR, "Manufacturer": device}],
        "ElementSet": [{"ElementID": COIL, "ElementType": "coil", "ModelName": device}],
        "IntensitySet": _intensities(record),
        "NavigationSystem": {
            "Navigation": True,
            "NavigationHardwareType": "robot",
            "NavigationModelName": f"PCMRS, {device} cell" if record.simulated else "PCMRS",
            "NavigationSoftwareVersion": record.versions.get("pcmrs", "unknown"),
        },
    }


def _intensities(record: SessionRecord) -> list[dict[str, Any]]:
    if record.threshold is None or record.hunt is None:
        return []
    settings = record.hunt.settings
    return [
        {
            "IntensityID": "rMT",
            "Value": record.threshold.threshold,
            "Units": PERCENT,
            "Type": "resting_motor",
            "Criterion": f"Half of the pulses evoke {settings.response_uv:g} uV peak to peak",
            "Algorithm": ALGORITHMS[settings.method],
            "MeasurementMethod": "EMG MEP",
        }
    ]


def _positions(record: SessionRecord) -> list[Position]:
    positions = [Position(position_id(pulse), pulse.phase, pulse.coil) for pulse in record.pulses]
    if record.hotspot is not None:
        positions.append(Position("hotspot", "estimate", record.hotspot.image_from_coil, "M1_hand"))
    return positions
