"""What the console offers is what the daemon takes, as far as state, role, lease and latch decide."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import pytest

from pcmrs.console._choices import Choice, Choices, latch_of
from pcmrs.messages import LeaseState, Snapshot
from pcmrs.messages.identity import COMMANDING, ROLES, Role
from pcmrs.messages.setup import Setup
from tests.unit.console.detached_page import ENGLISH
from tests.unit.console.shown_cell import setup
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

STAGES: list[Callable[[WorkflowBench], Awaitable[Any]]] = [
    lambda bench: bench.clock.sleep(0.0),
    WorkflowBench.connect,
    WorkflowBench.register,
    WorkflowBench.to_standoff,
    WorkflowBench.to_placed,
]


def offered(choices: Choices, shown: Snapshot, who: Setup) -> tuple[list[Choice], list[Choice]]:
    """What it offers, and what it does not."""
    found = list(choices.all(shown, who).values())
    return [each for each in found if not each.why_not], [each for each in found if each.why_not]


@pytest.mark.parametrize("stage", range(len(STAGES)))
async def test_choice_not_offered_is_rejected_and_changes_nothing(stage: int) -> None:
    async with open_bench() as bench:
        await STAGES[stage](bench)
        choices = Choices(bench.dispatcher.procedure.blueprint, ENGLISH)
        able, unable = offered(choices, bench.dispatcher.snapshot(), setup())
        assert able
        assert unable
        for choice in unable:
            before = bench.states, bench.data
            verdict = await bench.do(choice.name)
            assert verdict.decision == "rejected", choice
            assert (bench.states, bench.data) == before
        for choice in able:
            assert choice.operation in bench.dispatcher.procedure.allowed(choice.branch, bench.states), choice


@pytest.fixture
async def start() -> tuple[Choices, Snapshot]:
    async with open_bench() as bench:
        return Choices(bench.dispatcher.procedure.blueprint, ENGLISH), bench.dispatcher.snapshot()


@pytest.mark.parametrize("role", ROLES)
async def test_role_that_may_not_command_is_offered_nothing(start: tuple[Choices, Snapshot], role: Role) -> None:
    able, _ = offered(*start, msgspec.structs.replace(setup(), role=role))
    assert bool(able) == (role in COMMANDING)
    if role == "planner":
        assert not any(each.moves for each in able)


async def test_the_lease_of_others_closes_everything_but_to_a_planner(start: tuple[Choices, Snapshot]) -> None:
    choices, shown = start
    held = msgspec.structs.replace(shown, lease=LeaseState(holder="anna"))
    able, unable = offered(choices, held, setup())
    assert not able
    assert any("anna" in each.why_not for each in unable)
    assert offered(choices, held, msgspec.structs.replace(setup(), user="eve", role="planner"))[0]
    assert not offered(choices, shown, msgspec.structs.replace(setup(), lease_required=True))[0]


async def test_latch_is_shown_unconfirmed_until_standstill_is_known() -> None:
    async with open_bench() as bench:
        dispatcher = bench.dispatcher
        assert latch_of(None) is latch_of(dispatcher.snapshot()) is None
        stopping = dispatcher.begin_stop("test:operator")
        assert latch_of(dispatcher.snapshot()) == "latched_unconfirmed"
        assert await stopping
        assert latch_of(dispatcher.snapshot()) == "latched_standing"


async def test_the_latch_closes_what_moves_and_leaves_acknowledging(start: tuple[Choices, Snapshot]) -> None:
    choices, shown = start
    connected = shown.branches | {"robot": "1", "placement": "retracted"}
    able, unable = offered(choices, msgspec.structs.replace(shown, latched=True, branches=connected), setup())
    assert "robot.acknowledge" in {each.name for each in able}
    assert not any(each.moves for each in able)
    assert any("latched" in each.why_not for each in unable)


async def test_a_refused_operation_says_what_leads_on_to_it(start: tuple[Choices, Snapshot]) -> None:
    found = start[0].all(start[1], setup())
    assert found["robot.disconnect"].why_not.endswith(ENGLISH("leads_on", name="Connect"))
    assert found["placement.approach"].why_not.endswith(ENGLISH("leads_on", name="Plan landmarks"))


async def test_operations_have_names_in_words(start: tuple[Choices, Snapshot]) -> None:
    found = start[0].all(start[1], setup())
    assert found["registration.plan_landmarks"].title == "Plan landmarks"
    assert found["placement.reinit"].title == ENGLISH("start_again")
    assert found["registration.refine"].title == "Register by the landmarks and the points of the skin"
