"""Course of a session: intensities until responses are large, and an end where there is nothing to be found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs.workflows.toolplan import ToolPose
from pcmrs_lab.experiment.private import ExperimentBench
from pcmrs_lab.experiment.session.operator import SessionOperator
from pcmrs_lab.experiment.session.runner import LARGE_RESPONSE, MOST_INVALID, SessionRunner
from pcmrs_lab.experiment.session.setup import SessionSetup
from tests.unit.lab.scripted_client import verdict

PLAN = read_plan(example_plan("ratms"))
LARGE = {"counted": True, "mep": {"peak_to_peak": LARGE_RESPONSE}}
SMALL = {"counted": True, "mep": {"peak_to_peak": 0.9 * LARGE_RESPONSE}}
INVALID = {"counted": False, "problem_text": "The muscle was active."}


class ScriptedSession:
    """Operator, planner and setup of a session at once: what is asked of it, and what its pulses bring.

    Attributes:
        pulses: Results of the pulses, in order; the last one is repeated.
        states: States of a branch, one for each look at it.
    """

    interval, rate, method, threshold, ceiling, expected_pulses, plan = 0.0, 1.0, "adaptive", "ml", 80.0, 4, PLAN

    def __init__(self, *pulses: dict[str, Any], **states: list[str]) -> None:
        self.pulses = list(pulses)
        self.states = states
        self.asked: list[Any] = []
        self.shown: list[tuple[str, int, int]] = []

    def centre(self) -> ToolPose:
        return self.plan.poses[0]

    async def request(self, name: str, arguments: dict[str, Any] | None = None) -> None:
        self.asked.append((name, arguments["percent"]) if arguments and "percent" in arguments else name)

    async def fire(self, name: str) -> Any:
        self.asked.append(name)
        return msgspec.structs.replace(verdict(name), result=self.pulses.pop(0) if self.pulses[1:] else self.pulses[0])

    async def state(self, branch: str) -> str:
        return self.states[branch].pop(0)

    async def place(self) -> None:
        self.asked.append("place")

    async def withdraw(self) -> None:
        self.asked.append("withdraw")

    def __getattr__(self, name: str) -> Any:
        async def ask(*_: object) -> None:
            self.asked.append(name)

        return ask

    def runner(self, monkeypatch: pytest.MonkeyPatch) -> SessionRunner:
        monkeypatch.setattr(
            "pcmrs_lab.experiment.session.runner.SessionOperator", lambda *_: cast(SessionOperator, self)
        )
        bench = cast(ExperimentBench, SimpleNamespace(planner=self, client=None))
        return SessionRunner(bench, cast(SessionSetup, self), lambda *step: self.shown.append(step))

    @property
    def intensities(self) -> list[float]:
        return [each[1] for each in self.asked if isinstance(each, tuple) and each[0] == "stimulation.set_intensity"]


def found(*pulses: dict[str, Any]) -> ScriptedSession:
    return ScriptedSession(*pulses, hotspot=["searching", "found"], threshold=["hunting", "hunting", "found"])


async def test_intensity_rises_until_two_responses_in_a_row_are_large(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(SMALL, LARGE, SMALL, LARGE, LARGE)
    await session.runner(monkeypatch).run()
    assert session.intensities == [50.0, 58.0, 66.0]
    assert session.asked.count("stimulation.fire") == 5


async def test_intensity_never_exceeds_the_ceiling(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(SMALL)
    await session.runner(monkeypatch).run()
    assert session.intensities == [50.0, 58.0, 66.0, 74.0, 80.0]
    assert ("stimulation.set_ceiling", 80.0) in session.asked


async def test_a_low_ceiling_is_the_first_intensity(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(LARGE)
    session.ceiling = 30.0
    await session.runner(monkeypatch).run()
    assert session.intensities == [30.0]


async def test_a_pulse_that_does_not_count_is_repeated_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(INVALID, LARGE, INVALID, LARGE)
    await session.runner(monkeypatch).run()
    assert session.intensities == [50.0]
    assert session.asked.count("stimulation.fire") == 4


async def test_many_invalid_pulses_in_a_row_end_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(LARGE, *[INVALID] * MOST_INVALID)
    with pytest.raises(CommandRefusedError, match=rf"{MOST_INVALID} pulses in a row.*The muscle was active"):
        await session.runner(monkeypatch).run()
    assert session.asked.count("stimulation.fire") == 1 + MOST_INVALID


@pytest.mark.parametrize(
    ("states", "text"),
    [
        ({"hotspot": ["idle"]}, "No hot-spot was found"),
        ({"hotspot": ["found"], "threshold": ["hunting", "refused"]}, "No threshold was found: too_far"),
    ],
)
async def test_what_is_not_found_is_named_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, states: dict[str, list[str]], text: str
) -> None:
    session = ScriptedSession(LARGE | {"refusal": "too_far"}, **states)
    with pytest.raises(CommandRefusedError, match=text):
        await session.runner(monkeypatch).run()
    assert "withdraw" not in session.asked


async def test_whole_session_ends_at_home_and_pulses_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(LARGE)
    await session.runner(monkeypatch).run()
    assert session.asked[-2:] == ["withdraw", "robot.disconnect"]
    assert [text for text, _, _ in session.shown if "threshold" in text] == [
        "estimating the threshold, pulse 4",
        "estimating the threshold, pulse 5",
    ]
    assert all(done < total for _, done, total in session.shown), "more pulses than expected are never all of them"


async def test_coil_is_placed_over_the_hand_area_and_at_the_hotspot(monkeypatch: pytest.MonkeyPatch) -> None:
    session = found(LARGE)
    await session.runner(monkeypatch).run()
    order = [
        name for name in session.asked if name in ("plan_pose", "place", "toolplan.aim_hotspot", "threshold.begin")
    ]
    assert order == ["plan_pose", "place", "toolplan.aim_hotspot", "toolplan.aim_hotspot", "place", "threshold.begin"]
