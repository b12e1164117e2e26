"""A subject without a cell: lines that move the coil and change the muscle."""

import pytest

from pcmrs.errors import DeviceError
from pcmrs.testing.clock import ManualClock
from pcmrs_sim.lsl.emg_bench import USAGE, EmgBench
from pcmrs_sim.settings import MuscleSettings

QUIET = MuscleSettings(noise_uv=0.0, hum_uv=0.0, artefact_mv=0.0)


def make_bench(clock: ManualClock | None = None, seed: int = 3) -> EmgBench:
    return EmgBench(QUIET, seed, clock or ManualClock())


def response(bench: EmgBench, number: int = 1) -> float:
    return bench.stimulate(number, 100.0, 100.0).amplitude


def test_a_line_moves_the_coil_away_from_the_hotspot_and_back() -> None:
    bench, stays = make_bench(), make_bench()
    assert response(bench) == response(stays) > 200e-6
    bench.execute("coil 60 0 0 0")
    response(stays, 2)
    assert response(bench, 2) < 50e-6
    bench.execute("coil 0 0 0 0\n")
    assert response(bench, 3) == response(stays, 3), "nothing but the pose has changed"


def test_a_coil_turned_by_a_right_angle_has_less_effect() -> None:
    turned, around, straight = make_bench(), make_bench(), make_bench()
    turned.execute("coil 0 0 0 90")
    around.execute("coil 0 0 0 360")
    assert response(turned) < response(straight) == pytest.approx(response(around))


def test_a_silent_muscle_answers_again_when_it_is_switched_back() -> None:
    bench = make_bench()
    bench.execute("no_mep on")
    assert response(bench) == 0.0
    bench.execute("no_mep off")
    assert response(bench, 2) > 0.0


def test_preactivation_is_in_microvolts_from_now_on() -> None:
    bench = make_bench()
    bench.execute("preactivation 40")
    rate, now = QUIET.rate_hz, 100  # s of a manual clock at its start
    assert not bench.muscle.samples((now - 1) * rate, rate).any()
    assert bench.muscle.samples(now * rate, rate).std() == pytest.approx(40e-6, rel=0.05)


@pytest.mark.parametrize(
    "line",
    ["", "nonsense", "coil", "coil 1 2 3", "coil 1 2 3 4 5", "coil nan 0 0 0", "coil 0 0 0 inf", "no_mep", "no_mep 1",
     "preactivation", "preactivation much", "preactivation nan"],
)  # fmt: skip
def test_other_lines_are_refused_with_usage_and_change_nothing(line: str) -> None:
    bench, untouched = make_bench(), make_bench()
    with pytest.raises(DeviceError) as refused:
        bench.execute(line)
    assert USAGE in refused.value.text
    assert refused.value.fields == {"line": line}
    assert response(bench) == response(untouched)
