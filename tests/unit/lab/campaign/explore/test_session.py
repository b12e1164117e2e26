"""A session does its acts in their order, ends with the first violation, and leaves nothing behind."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import structlog

from pcmrs.journal import Journal
from pcmrs.messages import Running
from pcmrs.testing.journal import row
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign.explore import session as running
from pcmrs_lab.campaign.explore.operators import PATIENCE
from pcmrs_lab.campaign.explore.plans import GARBAGE, landmark_commands, pose_commands
from pcmrs_lab.campaign.explore.script import Act, SessionScript
from pcmrs_lab.campaign.explore.session import LONGEST_FOLLOWING, ExploredSession, quiet
from tests.unit.lab.campaign.explore.ratms_views import PLACED, READY, shown
from tests.unit.lab.campaign.explore.scripted_session import ScriptedCell, now, witness


class ScriptedOperators:
    """Operators who only say what they do, when; every request takes a second."""

    def __init__(self) -> None:
        self.snapshot: Any = None
        self.clock = SimpleNamespace(ahead=0.0)
        self.did: list[tuple[float, str, str, Any]] = []
        self.takes = 1.0

    def _do(self, what: str, who: str, more: Any = None) -> None:
        self.did.append((round(now(), 3), what, who, more))

    async def operate(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        self._do(name, who, arguments)
        await asyncio.sleep(self.takes)

    async def reuse(self, who: str, name: str, arguments: dict[str, Any]) -> None:
        self._do(f"reuse {name}", who, arguments)

    async def wire(self, who: str, name: str, tokens: Any) -> None:
        self._do(f"wire {name}", who, tokens)

    async def repeat(self, who: str) -> None:
        self._do("repeat", who)

    def old_client(self, name: str, tokens: Any) -> None:
        self._do(f"old {name}", "", tokens)

    def datagram(self, who: str, data: bytes) -> None:
        self._do("datagram", who, data)

    def stop(self, who: str) -> None:
        self._do("stop", who)


class Played:
    """A session that was played by scripted operators."""

    def __init__(self, *acts: Act, snapshot: Any = None, takes: float = 1.0, workflow: str = "ratms") -> None:
        self.acts, self.snapshot, self.takes, self.workflow = acts, snapshot, takes, workflow

    async def _play(self, prepare: Any) -> Played:
        self.cell, self.witness, self.operators = ScriptedCell(), witness(), ScriptedOperators()
        self.operators.snapshot, self.operators.takes = self.snapshot, self.takes
        session = ExploredSession(self.cell.as_cell, self.witness, SessionScript(1, self.workflow, acts=[*self.acts]))
        session._operators = session.faults._operators = self.operators  # type: ignore[assignment]
        if self.snapshot is not None:
            self.witness.view.take_snapshot(self.snapshot)
        if prepare is not None:
            prepare(self)
        await session.run(0.0)
        self.ended = now()
        return self

    def play(self, prepare: Any = None) -> Played:
        return run_on_simulated_loop(self._play(prepare))

    @property
    def did(self) -> list[tuple[str, str, Any]]:
        return [each[1:] for each in self.operators.did]

    @property
    def times(self) -> list[float]:
        return [each[0] for each in self.operators.did]


@pytest.mark.parametrize(
    ("act", "did"),
    [
        (Act(0.0, "stop", "ben"), ("stop", "ben", None)),
        (Act(0.0, "repeat", "ben"), ("repeat", "ben", None)),
        (Act(0.0, "datagram", "ben", {"number": len(GARBAGE) + 2}), ("datagram", "ben", GARBAGE[2])),
        (Act(0.0, "reuse:toolplan.clear", "ben", {"a": 1}), ("reuse toolplan.clear", "ben", {"a": 1})),
        (Act(0.0, "old:x", "ben", {"tokens": [1, 2]}), ("old x", "", (1, 2))),
        (Act(0.0, "wire:x", "ben", {"tokens": [1, 2]}), ("wire x", "ben", (1, 2))),
        (Act(0.0, "placement.home", "ben", {"confirm": True}), ("placement.home", "ben", {"confirm": True})),
        (Act(0.0, "go_on", "anna", {"turn": 1}), ("robot.connect", "anna", {})),
    ],
)
def test_an_act_is_done_by_its_operator(act: Act, did: tuple[str, str, Any]) -> None:
    assert Played(act).play().did == [did]


def test_a_plan_is_sent_where_an_act_gives_none() -> None:
    landmarks, pose = Act(0.0, "registration.plan_landmarks", "anna"), Act(0.0, "toolplan.plan", "anna")
    given = Act(0.0, "toolplan.plan", "anna", {"position": [0, 0, 0]})
    found = {name: arguments for name, _, arguments in Played(landmarks, pose).play().did}
    assert found["registration.plan_landmarks"]["landmarks"]
    assert set(found["toolplan.plan"]) == {"position", "quat_xyzw"}
    assert Played(given).play().did[0][2] == {"position": [0, 0, 0]}


def test_a_plan_by_wire_is_many_commands() -> None:
    snapshot = shown(states={"robot": "1", "placement": "retracted"})
    played = Played(Act(0.0, "go_on", "anna", {"turn": 1}), snapshot=snapshot).play()
    assert [name for name, *_ in played.did] == [f"wire {name}" for name, _ in landmark_commands("ratms")]
    played = Played(Act(0.0, "go_on", "anna", {"turn": 3}), snapshot=shown(states=READY | {"toolplan": "0"})).play()
    assert [(name, tokens) for name, _, tokens in played.did] == [
        (f"wire {name}", tokens) for name, tokens in pose_commands("ratms", 3)
    ]


def test_an_acknowledgement_names_the_stop_that_is_shown() -> None:
    played = Played(Act(0.0, "robot.acknowledge", "ben"), snapshot=shown()).play()
    assert played.did == [("robot.acknowledge", "ben", {"stop": 0})]
    assert Played(Act(0.0, "robot.acknowledge", "ben")).play().did[0][2] == {}


def test_acts_come_after_their_pauses_and_verdicts() -> None:
    acts = (
        Act(0.5, "placement.approach", "anna"),
        Act(0.5, "placement.confirm", "anna", {}, waits=False),
        Act(0.5, "placement.home", "ben"),
    )
    assert Played(*acts).play().times == [0.5, 2.0, 2.5]


def test_a_verdict_that_never_comes_is_not_waited_for_for_ever() -> None:
    acts = (Act(0.0, "placement.approach", "anna"), Act(0.0, "stop", "ben"))
    assert Played(*acts, takes=1e4).play().times == [0.0, PATIENCE]


def test_pauses_are_short_while_the_tool_follows() -> None:
    following = shown(states=PLACED | {"placement": "following"}, registration="r")
    act = Act(100.0, "stop", "ben")
    assert Played(act, snapshot=following).play().times == [LONGEST_FOLLOWING]
    assert Played(act).play().times == [100.0]


def test_an_act_may_wait_for_a_window() -> None:
    played = Played(Act(0.1, "stop", "ben", {}, True, "send:robot.*", 0.25)).play()
    assert played.cell.waited == [("send:robot.*", 0.25)]
    assert played.times == [0.1]


def test_a_session_ends_with_its_first_violation() -> None:
    def break_soon(played: Played) -> None:
        asyncio.get_running_loop().call_later(5.0, played.witness.break_, "stop_holds", "The arm moves.")

    acts = [Act(2.0, "placement.home", "anna") for _ in range(9)]
    played = Played(*acts).play(break_soon)
    assert played.ended == 5.0
    assert len(played.did) == 2


def test_a_session_ends_when_its_faults_have_ended() -> None:
    played = Played(Act(1.0, "fault:occlude", "", {"body": "coil", "on": True, "lasts": 7.0}, waits=False)).play()
    assert played.cell.scene.injected[-1] == ("occlude", {"body": "coil", "on": False})
    assert played.ended == 8.0 + running.QUIET_END
    assert played.witness.violation is None


def test_a_daemon_that_is_gone_is_started_at_the_end() -> None:
    def lose(played: Played) -> None:
        played.cell.daemon = None

    played = Played(Act(1.0, "stop", "ben")).play(lose)
    assert played.cell.happened == ["daemon started"]


def test_an_operation_that_never_ends_is_a_violation() -> None:
    approach = Running(branch="placement", operation="approach", id="1")
    played = Played(Act(1.0, "stop", "ben"), snapshot=shown(states=READY, running=[approach])).play()
    assert played.witness.violation is not None
    assert played.witness.violation.invariant == "everything_ends"
    assert "placement.approach is still running" in played.witness.violation.text


def test_a_long_motion_at_the_end_is_no_violation() -> None:
    retreat = Running(branch="placement", operation="back_off", id="1")

    def end_late(played: Played) -> None:
        played.witness.view.snapshot = shown(states=READY, running=[retreat])
        ended = shown(states=READY)
        asyncio.get_running_loop().call_later(25.0, setattr, played.witness.view, "snapshot", ended)

    played = Played(Act(1.0, "stop", "ben"), snapshot=shown(states=READY, running=[retreat])).play(end_late)
    assert played.witness.violation is None
    assert played.ended == pytest.approx(25.0, abs=1.1)


def test_poses_that_the_daemon_takes_no_more_are_a_violation() -> None:
    def stale(played: Played) -> None:
        poses = SimpleNamespace(rate_hz=lambda body: 0.0 if body == running.REFERENCE else 10.0)
        assert played.cell.daemon is not None
        played.cell.daemon.procedure = SimpleNamespace(cell=SimpleNamespace(poses=poses))

    violation = Played(Act(1.0, "stop", "ben")).play(stale).witness.violation
    assert violation is not None
    assert violation.invariant == "poses_go_on"


def test_an_error_of_an_act_is_a_violation() -> None:
    def listen(played: Played) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: running._unhandled(played.witness, context))

    violation = Played(Act(0.0, "datagram", "ben", {}), Act(1.0, "stop", "ben")).play(listen).witness.violation
    assert violation is not None
    assert violation.invariant == "no_error_is_lost"
    assert "KeyError 'number'" in violation.text


def test_an_error_that_nobody_waits_for_is_a_violation() -> None:
    async def lose() -> Any:
        made = witness()
        running._unhandled(made, {"message": "Task exception", "exception": ValueError("bad")})
        return made.violation

    violation = run_on_simulated_loop(lose())
    assert (violation.invariant, violation.text) == ("no_error_is_lost", "Task exception: ValueError bad")


async def test_the_last_row_tells_journals_apart(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path)
    assert running._digest(path) == ("", 0)
    await journal.append([row("run0", 0, 1)])
    await journal.append([row("run0", 0, 2)])
    digest, rows = running._digest(path)
    await journal.close()
    assert rows == 2
    assert len(bytes.fromhex(digest)) == 32


def test_logs_are_dropped_during_a_session_only(capsys: pytest.CaptureFixture[str]) -> None:
    before = structlog.get_config()

    def fail() -> None:
        structlog.get_logger("session").critical("dropped")
        raise KeyError

    with pytest.raises(KeyError), quiet():
        fail()
    assert structlog.get_config() == before
    assert "dropped" not in "".join(capsys.readouterr())
