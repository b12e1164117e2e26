"""States, flags and data of a procedure change together, and only by commits."""

from __future__ import annotations

from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import Bench


async def test_15_flags_follow_the_states_and_decide_nothing(bench: Bench) -> None:
    await bench.go(("110", "1", "0", "0", "unknown", "0", "off"))
    assert bench.dispatcher.snapshot().flags["landmarks_digitized"]
    bench.dispatcher.snapshot().flags["landmarks_digitized"] = False
    assert (await bench.do("registration.register")).decision == "accepted"


async def test_15_a_flag_that_does_not_mirror_its_state_is_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._flags["registered"] = True
    verdict = await bench.do("toolplan.plan")
    assert (verdict.decision, bench.joint, bench.holds) == ("unknown", INITIAL, 1)
    assert (await bench.do("toolplan.plan")).decision == "rejected"


async def test_15_two_active_states_are_fail_stop(bench: Bench) -> None:
    bench.dispatcher.procedure._engine._states.objects["robot"]["1"].activate()
    assert (await bench.do("toolplan.plan")).decision == "unknown"
    assert bench.holds == 1
    assert (await bench.do("toolplan.plan")).decision == "rejected"
