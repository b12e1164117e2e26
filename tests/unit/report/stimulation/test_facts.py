"""Numbers of the report, worked out from the record of a session."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from pcmrs.report.stimulation.facts import facts_of
from pcmrs.tms.scalp import as_transform
from tests.support.session_records import record


def test_facts_are_worked_out_from_the_truth() -> None:
    full, facts = record(), facts_of(record())
    assert full.truth is not None
    assert full.hotspot is not None
    assert full.threshold is not None
    true, found = as_transform(full.truth.hotspot), as_transform(full.hotspot.image_from_coil)
    assert facts.hotspot_error_mm == pytest.approx(1e3 * float(np.linalg.norm(true.translation - found.translation)))
    assert facts.threshold_error == pytest.approx(100.0 * (full.threshold.threshold - 51.5) / 51.5)
    assert facts.repeated == 2
    assert facts.counted == len(full.pulses) - 2
    assert facts.refused == 4


def test_errors_are_unknown_without_the_truth() -> None:
    facts = facts_of(msgspec.structs.replace(record(), truth=None))
    assert (facts.hotspot_error_mm, facts.threshold_error, facts.inside) == (None, None, None)
