"""The way on as a message: for each situation of a procedure it says what is next, and why."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.dispatcher.next_step import next_step
from pcmrs.errors import RefusalError
from pcmrs.fsm import guide_for
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")
GUIDE = guide_for(RATMS)
PLACED = RATMS.initial() | {
    "registration": "111", "digitization": "1", "toolplan": "1", "robot": "1", "placement": "placed",
}  # fmt: skip


def test_next_stage_is_named_with_the_way_to_it() -> None:
    found = next_step(GUIDE, RATMS.initial() | {"registration": "100", "toolplan": "1"})
    assert (found.next, found.stage, found.awaited) == ("digitization.digitize_one", "register", False)
    assert found.path == ["digitization.digitize_one", "registration.register"]
    assert "digitization.digitize_one, then registration.register" in found.why
    assert [(stage.id, stage.reached) for stage in found.stages] == [
        ("plan", True), ("register", False), ("connect", False), ("place", False),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "under_way"),
    [
        ("ratms", {}),
        ("ratms_threshold", {}),
        ("grid_mapping", {"mapping": "ready"}),
        ("femoroplasty", {"treatment": "ready"}),
    ],
)
def test_from_replanned_the_way_to_the_next_target_is_shown(name: str, under_way: dict[str, str]) -> None:
    """The position of the tool is known: no retreat comes first."""
    guide = guide_for(shipped_blueprint(name))
    states = {branch: PLACED.get(branch, start) for branch, start in guide.blueprint.initial().items()}
    found = next_step(guide, states | {"placement": "replanned"} | under_way)
    assert (found.next, found.path[:2]) == ("placement.approach", ["placement.approach", "placement.confirm"])


def test_while_stop_is_latched_its_release_is_next() -> None:
    found = next_step(GUIDE, PLACED | {"placement": "held"}, stop=7)
    assert (found.next, found.stage) == ("robot.acknowledge", "")
    assert found.why == "Stop 7 is latched: robot.acknowledge releases it."
    assert next_step(GUIDE, PLACED, stop=7, operation="placement.home").next == "robot.acknowledge"
    assert next_step(GUIDE, PLACED, stop=7, operation="toolplan.clear").why == "toolplan.clear is allowed now."


def test_way_to_an_operation_ends_with_it() -> None:
    found = next_step(GUIDE, PLACED | {"placement": "held"}, operation="placement.approach")
    assert found.path == ["placement.back_off", "placement.approach"]
    assert found.why == "It leads to placement.approach: placement.back_off, then placement.approach."


def test_reached_procedure_has_nothing_next() -> None:
    ended = msgspec.structs.replace(RATMS, stage=RATMS.declared_stages[:-1])
    found = next_step(guide_for(ended), PLACED)
    assert (found.next, found.why) == ("", "All stages are reached.")
    assert all(stage.reached for stage in found.stages)


def test_event_that_leads_on_is_awaited() -> None:
    guide = guide_for(shipped_blueprint("ratms_threshold"))
    states = guide.blueprint.initial() | PLACED | {"hotspot": "searching", "stimulation": "armed"}
    found = next_step(guide, states)
    assert (found.next, found.awaited, found.path[-1]) == ("alignment.within", True, "hotspot.pulse")


@pytest.mark.parametrize("name", ["robot.fly", "robot", "", "robot.link_lost", "registration.digitized"])
def test_only_operations_of_users_can_be_asked_about(name: str) -> None:
    if not name:
        assert next_step(GUIDE, PLACED, operation=name).stage == "finish"
        return
    with pytest.raises(RefusalError) as refused:
        next_step(GUIDE, PLACED, operation=name)
    assert refused.value.fields["operation"] == name
    assert "registration.plan_landmarks" in refused.value.text


def test_unreachable_operation_or_stage_says_so() -> None:
    impossible = RATMS.initial() | {"placement": "placed"}
    assert next_step(GUIDE, impossible, operation="placement.home").why.startswith("From here, nothing")
    assert next_step(GUIDE, impossible).why.endswith("nothing that users may request leads to it.")
