"""Data of a procedure with stimulation, and devices that a cell may lack."""

from __future__ import annotations

import pytest

from pcmrs.errors import RefusalError
from pcmrs.messages import PoseMessage
from pcmrs.tms.settings import ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.tms.data import Ceiling, Data, emg_of, settle
from tests.unit.workflows.stimulation_bench import StimulationBench


async def test_missing_stimulator_is_refused_with_the_setting_to_set(bench: StimulationBench) -> None:
    bench.bench.cell.stimulator = None
    await bench.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
    verdict = await bench.refuse("stimulation.set_intensity", "no_stimulator", percent=50.0)
    assert verdict.reason is not None
    assert "stimulator.driver" in verdict.reason.text


async def test_missing_electromyograph_is_refused_with_its_setting(bench: StimulationBench) -> None:
    assert emg_of(bench.bench.cell) is bench.emg
    bench.bench.cell.emg = None
    with pytest.raises(RefusalError, match=r"emg\.driver") as refused:
        emg_of(bench.bench.cell)
    assert refused.value.refusal_code == "no_emg"


POSE = PoseMessage(position=(0.0, 0.0, 0.1), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
HUNT = MotorThresholdEstimator.begin(ThresholdSettings())


@pytest.mark.parametrize(("hotspot", "threshold"), [("none", "none"), ("found", "none"), ("none", "hunting")])
def test_results_of_search_and_hunt_go_with_their_states(hotspot: str, threshold: str) -> None:
    """The rest stays: a ceiling is no result of either."""
    data = Data(ceiling=Ceiling(60.0, "Dr Hand"), search_intensity=50.0, hotspot=POSE, hunt=HUNT, given=3)
    settled = settle(data, {"hotspot": hotspot, "threshold": threshold, "registration": "111", "toolplan": "1"}, ())
    assert isinstance(settled, Data)
    assert (settled.hotspot, settled.search_intensity) == ((POSE, 50.0) if hotspot == "found" else (None, None))
    assert settled.hunt == (HUNT if threshold == "hunting" else None)
    assert (settled.ceiling, settled.given) == (data.ceiling, 3)


def test_stimulation_is_shown_by_percent_and_plain_data() -> None:
    shown = Data(ceiling=Ceiling(60.0, "Dr Hand"), intensity=50.0, hunt=HUNT).stimulation_view()
    assert (shown.ceiling, shown.intensity, shown.response) == (60.0, 50.0, None)
    assert isinstance(shown.hunt, dict)
    empty = Data().stimulation_view()
    assert (empty.ceiling, empty.intensity, empty.response, empty.hunt) == (None, None, None, None)
