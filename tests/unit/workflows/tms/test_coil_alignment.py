"""A pulse needs new frames of a coil at its place, on a head that keeps still."""

from __future__ import annotations

import pytest

from pcmrs.errors import RefusalError
from pcmrs.messages import HeadBurst, HeadMotion
from pcmrs.workflows._alignment import BODIES
from pcmrs.workflows.tms.coil_alignment import coil_on_target
from tests.unit.workflows.stimulation_bench import StimulationBench, stimulation


async def test_misplaced_coil_gives_no_pulse_even_if_still_aligned() -> None:
    """The gate tolerates an error for a while; a pulse does not."""
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.move_body((0.003, 0.0, 0.0))
        await bench.clock.sleep(1.0)
        assert bench.states["alignment"] == "1"
        verdict = await bench.refuse("stimulation.fire", "coil_off_target")
        assert verdict.reason is not None
        assert verdict.reason.fields["error_mm"] == pytest.approx(3.0, abs=0.3)
    assert not bench.stimulator.fired


async def test_body_not_seen_lately_allows_no_pulse() -> None:
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("body_ref", hidden=True)
        await bench.clock.sleep(0.5)
        assert bench.states["alignment"] == "1"
        await bench.refuse("stimulation.fire", "pose_stale")


async def test_too_few_frames_to_tell_a_speed_give_no_pulse() -> None:
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("body_ref", hidden=True)
        await bench.clock.sleep(1.0)
        await bench.bench.scene.occlude("body_ref", hidden=False)
        shown = bench.clock.monotonic()
        await bench.until(lambda: bool(bench.bench.cell.poses.together(BODIES, shown)))
        verdict = await bench.refuse("stimulation.fire", "pose_stale")
        assert verdict.reason is not None
        fields = verdict.reason.fields
        assert fields["age"] <= fields["limit"], "they are fresh"
        assert 0 < fields["frames"] < 4
        await bench.clock.sleep(0.1)
        await bench.accept("stimulation.fire")


async def test_a_head_that_moves_fast_gets_no_pulse() -> None:
    """S12: 86 mm/s, with a tolerance that would take the coil for placed."""
    loose = {"stimulation": {"tolerance_mm": 100.0, "intervals": {"least": 1.1}}, "alignment": {"off_time": 30.0}}
    burst = HeadMotion(bursts=[HeadBurst(time=0.1, duration=0.8, speed=0.086, direction=(1.0, 0.0, 0.0))])
    async with stimulation(loose) as bench:
        await bench.to_armed()
        await bench.bench.scene.set_motion(burst)
        await bench.clock.sleep(0.6)
        verdict = await bench.refuse("stimulation.fire", "head_moves")
        assert verdict.reason is not None
        assert verdict.reason.fields["speed"] == pytest.approx(0.086, abs=0.01)
        await bench.clock.sleep(1.0)
        await bench.accept("stimulation.fire")


async def test_no_pulse_by_frames_of_before_the_tracker_was_restarted() -> None:
    """They are forgotten; while the coil is hidden no new one shows where it is."""
    async with stimulation({"alignment": {"off_time": 30.0}}) as bench:
        await bench.to_armed()
        await bench.bench.scene.occlude("coil", hidden=True)
        await bench.clock.sleep(0.2)  # what has shown it is on its way for less
        bench.bench.tracker_session = "second"
        await bench.clock.sleep(0.5)
        assert (bench.states["alignment"], bench.states["placement"]) == ("1", "placed")
        verdict = await bench.refuse("stimulation.fire", "pose_stale")
        assert verdict.reason is not None
        assert "have not been seen together" in verdict.reason.text
    assert not bench.stimulator.fired


@pytest.mark.parametrize("missing", ["registered", "plan"])
async def test_no_pulse_without_a_registration_and_a_plan(armed: StimulationBench, missing: str) -> None:
    """A blueprint may forget to require them for its pulses: the check does not."""
    run = armed.bench.run("stimulation.fire")
    coil_on_target(run)
    run.keep(**{missing: None})
    with pytest.raises(RefusalError, match="both are needed for a pulse") as refused:
        coil_on_target(run)
    assert refused.value.refusal_code == "no_plan"
