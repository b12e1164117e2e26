"""A motor threshold is hunted by pulses that are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import RefusalError
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows._motion import pose_result
from pcmrs.workflows.tms.threshold import hunted_intensity_allowed, set_hunted_intensity
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.tms.recruitment import Recruitment
from tests.unit.workflows.stimulation_bench import SILENT, StimulationBench, result_of, stimulation
from tests.unit.workflows.workflow_bench import POSES, open_bench


@pytest.mark.parametrize(
    ("method", "off", "most"),
    [("ml", 5.0, 40), pytest.param("relative_frequency", 8.0, 120, marks=pytest.mark.nightly)],
)
async def test_the_threshold_is_found_by_pulses(armed: StimulationBench, method: str, off: float, most: int) -> None:
    muscle, rng = Recruitment(threshold=47.0), np.random.default_rng(5)
    armed.emg.amplitude = lambda intensity: muscle.sample(intensity, rng)
    begun = result_of(await armed.accept("threshold.begin", method=method))
    asked = [begun["next"]]
    while armed.states["threshold"] == "hunting":
        result = result_of(await armed.accept("threshold.pulse"))
        assert result["intensity"] == asked[-1]
        asked.append(result.get("next"))
        await armed.rest()
    assert armed.states["threshold"] == "found"
    assert armed.data.threshold.threshold == pytest.approx(47.0, abs=off)
    assert armed.data.given == len(armed.stimulator.fired) <= most
    assert max(intensity for _, intensity, _ in armed.stimulator.fired) <= 70.0
    assert result["estimate"]["threshold"] == armed.data.threshold.threshold


async def test_the_simulated_subject_has_the_threshold_that_is_found() -> None:
    """The simulated stimulator, muscle and electromyograph in place of the stand-ins; at the subject's own hot-spot."""
    async with open_bench({"stimulation": {"intervals": {"least": 1.1}}}, workflow="ratms_threshold") as bench:
        subject = draw_subject("head", seed=1)
        assert subject is not None
        await bench.register()
        await bench.accept("toolplan.plan", **pose_result(subject.image_from_hotspot))
        await bench.accept("placement.approach")
        await bench.accept("placement.confirm")
        await bench.accept("stimulation.set_ceiling", percent=100.0, operator="Dr Hand")
        await bench.accept("stimulation.set_intensity", percent=50.0)
        await bench.accept("stimulation.arm")
        await bench.until(lambda: bench.states["alignment"] == "1")
        await bench.accept("threshold.begin")
        while bench.states["threshold"] == "hunting":
            await bench.clock.sleep(1.2)
            assert result_of(await bench.accept("threshold.pulse"))["counted"]
        assert bench.states["threshold"] == "found"
        data: Any = bench.data
        assert data.threshold.threshold == pytest.approx(subject.recruitment.threshold, rel=0.1)


async def test_the_hunt_that_is_journalled_is_the_hunt(armed: StimulationBench) -> None:
    """Oracle: the hunt replayed from its own pulses."""
    await armed.accept("threshold.begin")
    for _ in range(4):
        await armed.accept("threshold.pulse")
        await armed.rest()
    hunt = MotorThresholdEstimator.begin(armed.data.hunt.settings)
    for pulse in armed.data.hunt.pulses:
        assert hunt.next_intensity() == pulse.intensity
        hunt = hunt.after(pulse.intensity, pulse.responded, pulse.amplitude)
    assert hunt == armed.data.hunt
    assert [pulse.intensity for pulse in hunt.pulses] == [intensity for _, intensity, _ in armed.stimulator.fired]


async def test_muscle_without_responses_has_no_threshold_below_ceiling(armed: StimulationBench) -> None:
    armed.emg.amplitude = lambda _: SILENT
    await armed.accept("threshold.begin", method="relative_frequency")
    while armed.states["threshold"] == "hunting":
        result = result_of(await armed.accept("threshold.pulse"))
        await armed.rest()
    assert (armed.states["threshold"], result["refusal"]) == ("none", "above_ceiling")
    assert max(intensity for _, intensity, _ in armed.stimulator.fired) <= 70.0


UNUSABLE: dict[str, Callable[[StimulationBench], None]] = {
    "preactivated": lambda bench: setattr(bench.emg, "baseline", 30e-6),
    "no_marker": lambda bench: setattr(bench.emg, "lost", True),
}


@pytest.mark.parametrize("problem", UNUSABLE)
async def test_a_pulse_that_says_nothing_teaches_no_hunt(armed: StimulationBench, problem: str) -> None:
    await armed.accept("threshold.begin")
    before = armed.data.hunt
    UNUSABLE[problem](armed)
    result = result_of(await armed.accept("threshold.pulse"))
    assert (result["problem"], result["pulses"], armed.states["threshold"]) == (problem, 0, "hunting")
    assert armed.data.hunt == before
    assert armed.data.given == 1


async def test_a_hunt_stays_below_the_ceiling_of_the_operator(armed: StimulationBench) -> None:
    await armed.accept("stimulation.disarm")
    await armed.accept("stimulation.set_ceiling", percent=5.0, operator="Dr Hand")
    await armed.refuse("threshold.begin", "ceiling_too_low")
    await armed.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
    await armed.accept("threshold.begin")
    await armed.accept("stimulation.set_ceiling", percent=30.0, operator="Dr Hand")
    await armed.accept("stimulation.set_intensity", percent=30.0)
    await armed.arm()
    await armed.refuse("threshold.pulse", "intensity_over_ceiling")
    assert not armed.stimulator.fired


async def test_threshold_is_not_hunted_before_a_ceiling_is_set() -> None:
    async with stimulation() as bench:
        await bench.bench.register()
        verdict = await bench.refuse("threshold.begin", "no_ceiling")
        assert verdict.reason is not None
        assert "stimulation.set_ceiling" in verdict.reason.text
        await bench.accept("stimulation.set_ceiling", percent=70.0, operator="Dr Hand")
        await bench.accept("threshold.begin")
        assert bench.data.hunt.settings.ceiling == 70.0


async def test_no_intensity_is_set_for_a_hunt_never_started(armed: StimulationBench) -> None:
    """A blueprint may let a pulse of a hunt be asked for at any time: check and step do not."""
    calls = len(armed.stimulator.calls)
    run = armed.bench.run("threshold.pulse")
    with pytest.raises(RefusalError, match=r"send threshold\.begin first") as refused:
        hunted_intensity_allowed(run)
    assert refused.value.refusal_code == "no_hunt"
    with pytest.raises(RefusalError):
        await set_hunted_intensity(run)
    assert "set_intensity" not in armed.stimulator.calls[calls:]


async def test_with_a_dial_no_pulse_is_given_before_it_is_turned() -> None:
    async with stimulation({"stimulation": {"dialled": True, "intervals": {"least": 1.1}}}) as bench:
        await bench.to_armed()
        asked = result_of(await bench.accept("threshold.begin"))["next"]
        assert asked != 50.0
        await bench.refuse("threshold.pulse", "not_dialled")
        await bench.accept("stimulation.set_intensity", percent=asked)
        await bench.accept("threshold.pulse")
        assert bench.stimulator.fired[-1][1] == asked


async def test_elsewhere_is_another_threshold(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    await armed.accept("toolplan.plan", **POSES[1])
    assert (armed.states["threshold"], armed.data.hunt) == ("none", None)
    await armed.accept("toolplan.clear")
    await armed.refuse("threshold.begin", "no_plan")
