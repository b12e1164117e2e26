"""Steps that reach the patient: barred by Stop, done once, and made safe."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
import tomli_w

from pcmrs.authoring.design import design
from pcmrs.authoring.trial.tour import TourCommand
from pcmrs.fsm import Denial, Engine
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.messages import Command, Verdict
from pcmrs.testing.rehearsal import ScriptedSteps, scripted_dispatcher
from tests.unit.authoring.design.biopsy_cell import INSERTION, WAY_IN, biopsy_cell, is_accepted, perform
from tests.unit.authoring.design.hazard_tables import hazard_table


@pytest.fixture
def cell() -> Engine:
    return biopsy_cell()


def test_stop_bars_patient_contact_and_one_operation_unlatches(cell: Engine) -> None:
    operations = cell.blueprint.branches["procedure"].operations
    barred = {name for name, operation in operations.items() if operation.blocked_when_latched}
    assert barred == {"align", "insert", "take_sample", "allow_insert_again", "allow_take_sample_again"}
    assert cell.blueprint.unlatching == ["safety.acknowledge"]


def test_after_the_sample_nothing_starts_again_by_itself(cell: Engine) -> None:
    perform(cell, *WAY_IN, *INSERTION, "procedure.take_sample")
    for refused in ("register", "plan_path", "align", "insert", "take_sample", "reinit", "withdraw_guide"):
        assert not is_accepted(cell, f"procedure.{refused}"), refused
    perform(cell, "procedure.make_safe")
    assert not is_accepted(cell, "procedure.reinit")
    perform(cell, "procedure.register", "procedure.align")
    answer = cell.ask("procedure", "insert")
    assert isinstance(answer, Denial)
    perform(cell, "procedure.allow_insert_again", *INSERTION)
    assert not is_accepted(cell, "procedure.take_sample")


def test_once_all_is_allowed_again_the_procedure_can_begin_again(cell: Engine) -> None:
    perform(cell, *WAY_IN, *INSERTION, "procedure.take_sample", "procedure.make_safe")
    perform(cell, "procedure.allow_insert_again", "procedure.allow_take_sample_again", "procedure.reinit")
    assert cell.joint()["procedure"] == cell.blueprint.branches["procedure"].start


COMMANDS = 30


class Walk:
    """A dispatcher of a designed workflow, and what the table says of its operations, by their names alone.

    Attributes:
        barred: Operations that move the robot or affect the patient.
        once: Irreversible operations, each with the one that allows it again.
    """

    def __init__(self, table: dict[str, Any]) -> None:
        result = design(tomli_w.dumps(table).encode())
        assert not result.findings, (table, [str(finding) for finding in result.findings])
        blueprint, _ = read_blueprint(result.text.encode(), "designed")  # `design` has verified it
        assert blueprint is not None
        self.blueprint = blueprint
        self.script = ScriptedSteps()
        self.dispatcher = scripted_dispatcher(self.blueprint, self.script, outside=False)
        self.operations = [
            (branch, name)
            for branch, spec in self.blueprint.branches.items()
            for name, operation in spec.operations.items()
            if not (operation.iio or operation.event)
        ]
        self.barred: set[tuple[str, str]] = set()
        self.once: dict[str, str] = {}
        for step in table["steps"]:
            self._take(step)
        self._number = 0

    def _take(self, step: dict[str, Any]) -> None:
        name, refined = step["name"], step.get("refined_by", {})
        ways = [step["operation"], *(each["operation"] for each in step.get("alternatives", []))]
        if step.get("moves") or step.get("affects_patient"):
            names = ["perform"] if refined else ways
            self.barred |= {each for each in self.operations if each[1] in names and (not refined or name in each[0])}
        if step.get("irreversible"):
            self.once |= dict.fromkeys(ways, f"allow_{step['operation']}_again")
        back = [each for each in step.get("reopened_by", []) if isinstance(each, dict)]
        self.barred |= {each for each in self.operations if each[1] in [one["operation"] for one in back]}

    async def ask(self, branch: str, operation: str, rng: Random | None = None, **arguments: Any) -> Verdict:
        """Asks for an operation; its steps end as declared, or now and then fail where `rng` is given."""
        self._number += 1
        spec = self.blueprint.branches[branch].operations[operation]
        ending = rng.choice(list(spec.endings)) if rng else "done"
        fails = spec.steps[-1] if spec.steps and rng and rng.random() < 0.15 else ""
        self.script.move = TourCommand(
            branch=branch, operation=operation, ending=ending, at=fails, how="refuses", before=(), after=()
        )
        command = Command(
            id=str(self._number), branch=branch, operation=operation, arguments=arguments, source="test:user"
        )
        return await self.dispatcher.submit(command)

    async def release(self) -> None:
        verdict = await self.ask("safety", "acknowledge", stop=self.dispatcher.snapshot().stop.number)
        assert verdict.decision == "accepted", verdict


async def check(seeds: range) -> None:
    """Of random tables: after Stop no step reaches the patient, and no irreversible step is done twice."""
    for seed in seeds:
        rng = Random(seed)
        walk = Walk(hazard_table(rng))
        spent: set[str] = set()
        for _ in range(COMMANDS):
            branch, operation = rng.choice(walk.operations)
            verdict = await walk.ask(branch, operation, rng)
            if verdict.decision == "rejected":
                continue
            if operation in walk.once:
                allowing = walk.once[operation]
                assert allowing not in spent, (seed, operation)
                spent.add(allowing)
            spent.discard(operation)
        await walk.dispatcher.stop("test:user")
        before = walk.dispatcher.snapshot().branches
        for branch, operation in sorted(walk.barred):
            verdict = await walk.ask(branch, operation)
            assert verdict.reason is not None, (seed, operation)
            assert (verdict.decision, verdict.reason.code) == ("rejected", "latched"), (seed, operation)
            assert "safety.acknowledge" in verdict.reason.text
        assert walk.dispatcher.snapshot().branches == before
        await walk.release()
        assert not walk.dispatcher.snapshot().latched
        await walk.dispatcher.close()


@pytest.mark.parametrize("first", range(0, 100, 25))
async def test_after_stop_no_step_reaches_the_patient(first: int) -> None:
    """Nor is an irreversible step done twice."""
    await check(range(first, first + 25))


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(1_000, 2_000, 50))
async def test_after_stop_no_step_of_many_tables_is_done(first: int) -> None:
    await check(range(first, first + 50))
