"""Sessions of a workflow with timers are explored: all invariants hold, and the timers expire in them."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import msgspec

from pcmrs.workflows import find_workflow
from pcmrs_lab.campaign.explore.generate import draw_script
from pcmrs_lab.campaign.explore.session import run_session
from pcmrs_lab.campaign.explore.settings import workflow_of

TIMED = """
extends = "ratms.toml"
id = "timed_ratms"
version = "1"
goal = { placement = ["placed"] }

[branches.placement.timers.idle]
states = ["placed", "standoff"]
after_s = 15
posts = "left_alone"
restarted_by = ["placement.nudge", "placement.press"]

[branches.placement.operations.left_alone]
from = ["placed", "standoff"]
to = "held"
event = true

[branches.placement.timers.watched]
states = ["following"]
after_s = 5
posts = "force_limit"

[branches.registration.timers.outdated]
states = ["111"]
after_s = 100
posts = "outdated"
restarted_by = ["registration.register"]

[branches.registration.operations.outdated]
from = ["111"]
to = "110"
event = true

[branches.robot.timers.remind]
states = ["1"]
after_s = 20
posts = "reminded"
repeat = true

[branches.robot.operations.reminded]
from = ["1"]
to = "1"
event = true
"""
SEEDS = range(40)


def test_all_invariants_hold_with_timers(tmp_path: Path) -> None:
    shutil.copy(find_workflow("ratms").blueprint, tmp_path / "ratms.toml")
    workflow = tmp_path / "timed_ratms.toml"
    workflow.write_text(TIMED)
    blueprint, seen = workflow_of(str(workflow)).blueprint, Counter[str]()
    for seed in SEEDS:
        script = draw_script(blueprint, "timed_ratms", seed)  # which is the same whatever the folder is called
        found = run_session(msgspec.structs.replace(script, workflow=str(workflow)))
        assert (found.invariant, found.text) == ("", ""), seed
        seen.update(found.seen)
    for event in ("placement.left_alone", "placement.force_limit", "registration.outdated", "robot.reminded"):
        assert seen[f"accepted {event}"] > 0, event
