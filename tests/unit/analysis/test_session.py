"""Records of sessions: their pulses by purpose, and what is kept of them in a file."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.analysis.session import Phase, SessionRecord
from tests.support.session_records import nothing, record

PHASES: tuple[Phase, ...] = ("intensity", "hotspot", "threshold")


def test_every_pulse_has_one_purpose() -> None:
    by_phase = {phase: record().of_phase(phase) for phase in PHASES}
    numbers = [pulse.pulse for pulses in by_phase.values() for pulse in pulses]
    assert sorted(numbers) == sorted(pulse.pulse for pulse in record().pulses)
    for phase, pulses in by_phase.items():
        assert pulses
        assert {pulse.phase for pulse in pulses} == {phase}
        assert [pulse.onset for pulse in pulses] == sorted(pulse.onset for pulse in pulses)
    assert nothing().of_phase("hotspot") == ()


@pytest.mark.parametrize("seed", [None, 0, 7])
def test_a_session_with_a_seed_was_simulated(seed: int | None) -> None:
    """Seed 0 is one, too."""
    assert msgspec.structs.replace(record(), seed=seed).simulated == (seed is not None)


@pytest.mark.parametrize("made", [record, nothing])
def test_a_record_reads_back_as_it_was_written(made: object) -> None:
    kept = made()  # type: ignore[operator]
    assert msgspec.json.decode(msgspec.json.encode(kept), type=SessionRecord) == kept
