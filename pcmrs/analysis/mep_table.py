"""Tables of the responses and their signals, in BIDS style: one row for each pulse.

The tables are our own: NIBS-BIDS leaves responses to the modality that recorded them, and BIDS has no table of motor
evoked potentials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from pcmrs.analysis._bids import Column, write_ignored, write_json, write_table
from pcmrs.analysis.nibs_tables import EVENTS, PERCENT, TASK, description, position_id, subject_label
from pcmrs.analysis.session import PulseRecord, SessionRecord
from pcmrs.tms.mep import Mep

__all__ = ["write_meps"]

STATUS = {"good": "Counts", "bad": "Says nothing about the muscle; status_description says why"}
Sample = tuple[int, float, float]
"""Number of the pulse, time since it, s, and the signal, uV."""


def _of_mep(value: Callable[[Mep], Any]) -> Callable[[PulseRecord], Any]:
    """Return a function for a value of the measurement; it returns None for a pulse without one."""
    return lambda pulse: None if pulse.mep is None else value(pulse.mep)


def _since_pulse(time: float | None) -> float | None:
    return None if time is None else 1e3 * time


MEPS: tuple[Column[PulseRecord], ...] = (
    *(column for column in EVENTS if column.name in ("onset", "trial_type", "pulse", "nibs_event_id")),
    Column("nibs_position_id", "Position of the coil in *_markers.tsv of the raw dataset", position_id),
    Column("stimulus_intensity", "Of the pulse", lambda pulse: pulse.intensity, PERCENT),
    Column("position_error", "Of the coil against its planned pose, right before", lambda pulse: pulse.error_mm, "mm"),
    Column("rotation_error", "Likewise, of its rotation", lambda pulse: pulse.error_deg, "deg"),
    Column("muscle", "Channel", lambda pulse: None if pulse.epoch is None else pulse.epoch.muscle),
    Column("amplitude", "Peak to peak within the window", _of_mep(lambda mep: 1e6 * mep.peak_to_peak), "uV"),
    Column("latency", "From the pulse until the response begins", _of_mep(lambda mep: _since_pulse(mep.latency)), "ms"),
    Column("baseline_rms", "Activity before the pulse", _of_mep(lambda mep: 1e6 * mep.baseline_rms), "uV"),
    Column("response", "Whether there is one, and it can be believed", _of_mep(lambda mep: mep.present)),
    Column("preactivated", "The muscle was not at rest", _of_mep(lambda mep: mep.preactivated)),
    Column("saturated", "The amplifier was at its limit", _of_mep(lambda mep: mep.saturated)),
    Column("artefact", "The stimulus reaches into the window", _of_mep(lambda mep: mep.artefact)),
    Column("status", "Whether the pulse counts", lambda pulse: "bad" if pulse.problem else "good", levels=STATUS),
    Column("status_description", "Why it does not", lambda pulse: pulse.problem_text or None),
)

SAMPLES: tuple[Column[Sample], ...] = (
    Column("pulse", "Number of the pulse", lambda sample: sample[0]),
    Column("time", "Since the pulse: negative before it", lambda sample: round(sample[1], 6), "s"),
    Column("emg", "As it was measured", lambda sample: round(sample[2], 3), "uV"),
)


def write_meps(record: SessionRecord, dataset: Path) -> None:
    """Write table and signals.

    Args:
        record: The session.
        dataset: Folder of a derived dataset.
    """
    name = f"sub-{subject_label(record)}"
    stem = f"{name}_task-{TASK}"
    settings = record.mep_settings
    write_json(dataset / "dataset_description.json", description(record, "derivative"))
    write_ignored(dataset, "emg/")
    fields = {
        "ResponseWindow": [1e3 * settings.window_start, 1e3 * settings.window_end],
        "ResponseWindowUnits": "ms",
        "ResponseThreshold": settings.threshold_uv,
        "ResponseThresholdUnits": "uV",
    }
    write_table(dataset / name / "emg" / f"{stem}_mep.tsv", MEPS, record.pulses, **fields)
    write_table(dataset / name / "emg" / f"{stem}_epochs.tsv.gz", SAMPLES, _samples(record))


def _samples(record: SessionRecord) -> Iterator[Sample]:
    """Yield the samples of all signals, one after the other."""
    for pulse in record.pulses:
        epoch = pulse.epoch
        if epoch is not None:
            for index, volts in enumerate(epoch.samples):
                yield pulse.pulse, epoch.start + index / epoch.rate_hz, 1e6 * volts
