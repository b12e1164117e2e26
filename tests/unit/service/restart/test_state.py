"""State that a run takes over, from the rows of earlier ones."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.events import NOT_CONFIRMED, SHUTDOWN
from pcmrs.journal.notes import RESTORED, SOURCE
from pcmrs.service.restart.state import INITIAL_JOINTS, PersistedState, RestartState
from tests.support.trials import examples
from tests.unit.service.restart.earlier_runs import RATMS, as_row

STARTED = ("config", "daemon.started", None, None)


NAMES = [
    "placement.approach",
    "placement.locate",
    "placement.reinit",
    "robot.connect",
    "robot.acknowledge",
    "toolplan.plan",
]


ROWS = st.lists(
    st.one_of(
        st.tuples(st.just("intent"), st.sampled_from(NAMES), st.integers(0, 5), st.none()),
        st.tuples(
            st.just("outcome"),
            st.sampled_from(NAMES),
            st.integers(0, 5),
            st.sampled_from(["accepted", "rejected", "failed", "unknown", "ended"]),
        ),
        st.tuples(st.just("device"), st.sampled_from(["tracker.lost", "shutdown.stopped"]), st.booleans(), st.none()),
        st.tuples(
            st.just("activity"),
            st.sampled_from(["started", "ended"]),
            st.integers(0, 5),
            st.sampled_from(["placed", "following", "guided"]),
        ),
        st.tuples(st.just("config"), st.just("daemon.started"), st.none(), st.none()),
    ),
    max_size=30,
)


def after_an_unsure_end(robot: str) -> PersistedState:
    """Restart state after an orderly end with the robot in this state, which did not confirm that it stood."""
    restart_state = RestartState(RATMS, PersistedState())
    restart_state.take(as_row("device", f"{SHUTDOWN}.stopped", True, None))
    unsure = as_row("device", f"{SHUTDOWN}.{NOT_CONFIRMED}", True, None)
    restart_state.take(msgspec.structs.replace(unsure, states={"robot": robot}))
    return restart_state.kept


@examples(60)
@given(rows=ROWS, data=st.data())
def test_reading_on_from_any_snapshot_equals_reading_everything(rows: list[Any], data: st.DataObject) -> None:
    made = [as_row(*row) for row in rows]
    cut = data.draw(st.integers(0, len(made)))
    whole, before = RestartState(RATMS, PersistedState()), RestartState(RATMS, PersistedState())
    for row in made:
        whole.take(row)
    for row in made[:cut]:
        before.take(row)
    stored = msgspec.convert(msgspec.msgpack.decode(msgspec.msgpack.encode(before.kept)), PersistedState)
    after = RestartState(RATMS, stored)
    for row in made[cut:]:
        after.take(row)
    assert after.kept == whole.kept


@pytest.mark.parametrize(
    ("rows", "latched"),
    [
        ([("device", "operator.stopped", True, None)], True),
        ([("device", "tracker.slow", False, None)], False),
        ([("device", f"{SHUTDOWN}.stopped", True, None)], False),
        ([("device", "operator.stopped", True, None), ("device", f"{SHUTDOWN}.stopped", True, None)], True),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.acknowledge", 1, "accepted")], False),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.acknowledge", 1, "rejected")], True),
        ([("device", "operator.stopped", True, None), ("outcome", "robot.connect", 1, "accepted")], True),
        ([("intent", "placement.approach", 1, None), ("outcome", "placement.approach", 1, "ended")], True),
        ([("intent", "robot.connect", 1, None), ("outcome", "robot.connect", 1, "ended")], False),
        ([("activity", "started", 1, "following"), STARTED], True),
        ([("activity", "started", 1, "guided"), STARTED], True),
        ([("activity", "started", 1, "placed"), STARTED], False),
        ([("activity", "started", 1, "following"), ("activity", "ended", 1, "following"), STARTED], False),
        ([("activity", "started", 2, "following"), ("activity", "ended", 1, "following"), STARTED], True),
        (
            [
                ("activity", "started", 1, "guided"),
                ("device", "operator.stopped", True, None),
                ("outcome", "robot.acknowledge", 1, "accepted"),
                STARTED,
            ],
            False,
        ),
        ([("activity", "started", 1, "guided"), ("outcome", "robot.acknowledge", 1, "accepted"), STARTED], True),
        ([("activity", "started", 1, "guided"), STARTED, ("outcome", "robot.acknowledge", 1, "accepted")], False),
    ],
)
def test_latch_outlives_a_run_until_it_is_acknowledged(rows: list[Any], latched: bool) -> None:
    restart_state = RestartState(RATMS, PersistedState())
    for row in rows:
        restart_state.take(as_row(*row))
    assert restart_state.kept.latched == latched


def test_robot_not_seen_at_rest_at_an_orderly_end_is_latched() -> None:
    """It was connected."""
    assert after_an_unsure_end(robot="1").latched


def test_robot_not_connected_at_an_orderly_end_is_not_latched() -> None:
    assert not after_an_unsure_end(robot="0").latched


def test_only_what_explicit_operations_use_is_taken_back() -> None:
    restart_state = RestartState(RATMS, PersistedState())
    row = as_row("outcome", "toolplan.plan", 1, "accepted")
    assert row.result is not None
    restart_state.take(msgspec.structs.replace(row, result={**row.result, "plan_id": "p", "registration_id": "r"}))
    assert restart_state.kept.taken_back == row.result


def test_the_last_remembered_initial_posture_outlives_a_run() -> None:
    restart_state = RestartState(RATMS, PersistedState())
    row = as_row("device", f"gateway.{INITIAL_JOINTS}", False, None)
    for joints in ([0.1] * 7, [0.2] * 7):
        restart_state.take(msgspec.structs.replace(row, result={"fields": {"joints": joints}}))
    restart_state.take(as_row(*STARTED))
    assert restart_state.kept.initial_joints == (0.2,) * 7
    assert RestartState(RATMS, restart_state.kept).kept.initial_joints == (0.2,) * 7


@pytest.mark.parametrize(
    ("source", "result"),
    [
        ("tracker", {"fields": {"joints": [0.3] * 7}}),
        ("tracker", {"fields": {}}),
        ("gateway", None),
        ("gateway", {"fields": {}}),
        ("gateway", {"fields": {"joints": 3}}),
        ("gateway", {"fields": {"joints": ["a"] * 7}}),
        ("gateway", {"fields": {"joints": [float("nan")] * 7}}),
        ("gateway", {"fields": {"joints": []}}),
    ],
)
def test_only_joints_by_the_gateway_are_remembered(source: str, result: dict[str, Any] | None) -> None:
    restart_state = RestartState(RATMS, PersistedState(initial_joints=(0.1,) * 7))
    row = as_row("device", f"{source}.{INITIAL_JOINTS}", False, None)
    restart_state.take(msgspec.structs.replace(row, result=result))
    assert restart_state.kept.initial_joints == (0.1,) * 7


@pytest.mark.parametrize("code", ["activity_started", "activity_ended"])
def test_a_device_does_not_report_activities(code: str) -> None:
    """Only the dispatcher does; a device that uses its codes must not stop the daemon."""
    restart_state = RestartState(RATMS, PersistedState())
    restart_state.take(as_row("device", f"tracker.{code}", False, None))
    assert restart_state.kept == PersistedState()


def test_a_restored_cell_starts_latched_until_acknowledged() -> None:
    restart_state = RestartState(RATMS, PersistedState())
    row = msgspec.structs.replace(as_row(*STARTED), kind="event", source=SOURCE, operation=RESTORED)
    restart_state.take(row)
    assert restart_state.kept.latched
    restart_state.take(as_row("outcome", "robot.acknowledge", 1, "accepted"))
    assert not restart_state.kept.latched
