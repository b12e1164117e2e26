"""Activities in a blueprint: what cannot be meant is named, and every view of a workflow shows them."""

from __future__ import annotations

import msgspec

from pcmrs.authoring.difference import compare
from tests.support.altered import with_branch
from tests.unit.fsm.arm_workflow import arm_blueprint


def test_a_difference_in_them_is_one_in_behaviour() -> None:
    near = arm_blueprint().branches["arm"].activities["near"]
    without = with_branch(arm_blueprint(), "arm", activities={"near": near})
    said = [difference.text for difference in compare(arm_blueprint(), without)]
    assert said == [
        "arm.[following]: activity changed from follow_head to None",
        "arm.[following]: ended by changed from lost to None",
        "arm.[following]: moves changed from True to None",
    ]
    near = msgspec.structs.replace(near, run="see_head")
    other = with_branch(arm_blueprint(), "arm", activities={**arm_blueprint().branches["arm"].activities, "near": near})
    assert [difference.subject for difference in compare(other, arm_blueprint())] == ["arm.[near]"]
    assert compare(arm_blueprint(), arm_blueprint()) == []
