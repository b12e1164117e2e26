"""The random operator takes only legal steps, forward mostly, back sometimes, and presses Stop now and then."""

from __future__ import annotations

import random
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.errors import UnknownOutcomeError
from pcmrs_lab.campaign.operating import GOES_BACK, STOPS, RandomOperator, steps_back
from tests.unit.lab.campaign.scripted_cell import run
from tests.unit.lab.scripted_client import ScriptedClient, rejected, snapshot

READY = {"robot": "1", "registration": "111", "toolplan": "1", "placement": "retracted"}
FORWARD = {
    "robot.connect": {"robot": "1"},
    "robot.disconnect": {"robot": "0"},
    "registration.plan_landmarks": {"registration": "100"},
    "digitization.digitize_all": {"registration": "110"},
    "registration.register": {"registration": "111"},
    "registration.reinit": {"registration": "000"},
    "toolplan.plan": {"toolplan": "1"},
    "toolplan.clear": {"toolplan": "0"},
    "placement.approach": {"placement": "standoff"},
    "placement.confirm": {"placement": "placed"},
    "placement.home": {"placement": "retracted"},
    "placement.back_off": {"placement": "standoff"},
    "placement.locate": {"placement": "retracted"},
}


class Steady(random.Random):
    """A generator that never chooses Stop or a step back."""

    def random(self) -> float:
        return 1.0

    def getrandbits(self, k: int, /) -> int:
        return super().getrandbits(k)


def client(**branches: str) -> ScriptedClient:
    made = ScriptedClient(**(READY | branches))
    made.leads |= FORWARD
    return made


def operator(cell: ScriptedClient, seed: int = 1, *, steady: bool = False) -> RandomOperator:
    return RandomOperator(cell.as_client, Steady(seed) if steady else random.Random(seed))


@pytest.mark.parametrize(
    ("branches", "step"),
    [
        ({"robot": "0"}, "robot.connect"),
        ({"placement": "unknown", "registration": "000"}, "placement.locate"),
        ({"placement": "held"}, "placement.back_off"),
        ({"registration": "000"}, "registration.plan_landmarks"),
        ({"registration": "000", "placement": "standoff"}, "placement.home"),
        ({"registration": "100"}, "digitization.digitize_all"),
        ({"registration": "110"}, "registration.register"),
        ({"toolplan": "0"}, "toolplan.plan"),
        ({"placement": "retracted"}, "placement.approach"),
        ({"placement": "standoff"}, "placement.confirm"),
        ({"placement": "placed"}, "placement.home"),
    ],
)
async def test_the_next_step_is_that_of_the_procedure(branches: dict[str, str], step: str) -> None:
    cell = client(**branches)
    await operator(cell, steady=True).step()
    assert cell.asked == [step]


async def test_a_stop_is_acknowledged_by_its_number() -> None:
    cell = client()
    await cell.stop()
    await cell.stop()
    await operator(cell, steady=True).step()
    assert cell.calls == [("robot.acknowledge", {"stop": 2})]


@pytest.mark.parametrize(
    ("branches", "steps"),
    [
        ({"placement": "standoff"}, {"placement.home", "placement.back_off"}),
        (
            {},
            {"registration.reinit", "registration.plan_landmarks", "toolplan.clear", "robot.disconnect"},
        ),
        ({"robot": "0"}, set()),
        ({"placement": "held"}, set()),
        ({"placement": "unknown"}, set()),
    ],
)
def test_a_step_back_is_legal(branches: dict[str, str], steps: set[str]) -> None:
    shown = replace(snapshot(), branches=READY | branches)
    assert {name for name, _ in steps_back(shown)} == steps
    assert steps_back(replace(shown, latched=True)) == []


def test_a_cell_is_operated_all_over(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = client(robot="0", registration="000", toolplan="0")
    operating = operator(cell)

    async def operate() -> int:
        steps = 0
        for _ in range(1000):
            if await operating.step() is not None:
                cell.latched = False
                steps += 1
        return steps

    steps = run(monkeypatch, operate())
    assert operating.stops == 1000 - steps
    assert operating.stops / 1000 == pytest.approx(STOPS, abs=0.025)
    assert set(cell.asked) >= set(FORWARD) - {"placement.locate"}
    back = sum(name in ("registration.reinit", "toolplan.clear", "robot.disconnect") for name in cell.asked)
    assert 0 < back < GOES_BACK * steps
    assert len(operating.verdicts) == steps, "every command has its own id"


async def test_every_command_has_its_own_id_when_verdicts_are_dropped() -> None:
    """A repeated id gets the verdict of the first command, or is refused: nothing would be operated any more."""
    ids: list[str] = []
    cell = client(robot="0")
    operating = operator(cell)
    for _ in range(20):
        await operating.step()
        cell.latched = False
        ids += operating.verdicts
        operating.verdicts.clear()
    assert len(ids) > 10
    assert len(set(ids)) == len(ids)


def test_an_operator_waits_after_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = client()
    cell.answers["placement.approach"] = [rejected("busy")]
    waited: list[Any] = []
    monkeypatch.setattr("pcmrs.simulated_time.clock.SimulatedClock.sleep", lambda _, time: _wait(waited, time))
    decided = run(monkeypatch, operator(cell, steady=True).step())
    assert decided is not None
    assert (decided.decision, len(waited)) == ("rejected", 1)


async def _wait(waited: list[Any], time: float) -> None:
    waited.append(time)


async def test_a_daemon_that_is_gone_ends_the_operator() -> None:
    cell = client()
    cell.silent = True
    with pytest.raises(UnknownOutcomeError):
        await operator(cell, steady=True).step()


async def test_no_two_operators_of_a_cell_use_the_same_ids() -> None:
    cell = client()
    generator = Steady(1)
    first, second = (RandomOperator(cell.as_client, generator) for _ in range(2))
    await first.step()
    await second.step()
    assert not first.verdicts.keys() & second.verdicts.keys()
