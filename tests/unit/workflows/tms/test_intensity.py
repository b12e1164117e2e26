"""The intensity stays below the operator's ceiling, and the stimulator must report what was set."""

from __future__ import annotations

from typing import Any

from tests.unit.workflows.stimulation_bench import StimulationBench


async def test_intensity_needs_a_ceiling_and_stays_below(bench: StimulationBench) -> None:
    await bench.refuse("stimulation.set_intensity", "no_ceiling", percent=10.0)
    await bench.bench.to_placed()
    await bench.refuse("stimulation.arm", "no_intensity")
    await bench.accept("stimulation.set_ceiling", percent=60.0, operator="Dr Hand")
    verdict = await bench.refuse("stimulation.set_intensity", "intensity_over_ceiling", percent=60.5)
    assert verdict.reason is not None
    assert "Dr Hand" in verdict.reason.text
    await bench.accept("stimulation.set_intensity", percent=60.0)
    await bench.accept("stimulation.set_ceiling", percent=40.0, operator="Dr Hand")
    await bench.refuse("stimulation.arm", "intensity_over_ceiling")
    assert bench.data.ceiling.percent == 40.0


async def test_invalid_ceiling_is_refused(bench: StimulationBench) -> None:
    wrong: list[dict[str, Any]] = [
        {"percent": 0.0, "operator": "x"},
        {"percent": 100.5, "operator": "x"},
        {"percent": float("nan"), "operator": "x"},
        {"percent": 50.0, "operator": ""},
        {"percent": 50.0, "operator": "a\nb"},
        {"percent": 50.0},
    ]
    for arguments in wrong:
        await bench.refuse("stimulation.set_ceiling", "bad_arguments", **arguments)


async def test_the_ceiling_stays_while_armed(armed: StimulationBench) -> None:
    await armed.refuse("stimulation.set_ceiling", "invalid_in_state", percent=90.0, operator="Dr Hand")


async def test_turned_dial_is_detected(armed: StimulationBench) -> None:
    armed.stimulator.reports = 65.0
    await armed.refuse("stimulation.fire", "intensity_differs", "failed")
    assert not armed.stimulator.fired
