"""Tables of responses read back as what they were made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcmrs.analysis._bids import MISSING
from tests.support.session_records import record
from tests.unit.analysis.tables import STEM, rows


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
