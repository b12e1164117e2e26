"""A small workflow in which a tool follows the body: one activity moves the robot, another only watches."""

from __future__ import annotations

from pcmrs.fsm import parse_blueprint

TEXT = """
id = "following"
version = "1"

[branches.plan]
states = { old = "as it was", new = "changed" }
[branches.plan.operations.change]
from = ["old"]
to = "new"
[branches.plan.operations.change_back]
from = ["new"]
to = "old"

[branches.robot]
states = { ready = "connected" }
[branches.robot.operations.acknowledge]
from = ["ready"]
to = "ready"
unlatches = true

[branches.placement]
revocations = [{ by = ["plan"], from = ["following", "placed"], to = "held" }]

[branches.placement.states]
away = "clear"
near = "at the body"
following = "moves with the body"
placed = "stands"
held = "let go"
stopped = "stopped in a motion"

[branches.placement.activities]
following = { run = "follow_head", ended = "following_lost", moves = true }
placed = { run = "watch_alignment", ended = "alignment_lost" }

[branches.placement.operations.approach]
from = ["away", "held"]
to = "near"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"

[branches.placement.operations.follow]
from = ["near", "placed"]
to = "following"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"

[branches.placement.operations.stand]
from = ["following"]
to = "placed"
motion = "approach"
checks = ["stand_possible"]
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"

[branches.placement.operations.adjust]
from = ["following", "placed"]
to = { following = "following", placed = "placed" }

[branches.placement.operations.let_go]
from = ["following", "placed"]
to = "held"

[branches.placement.operations.withdraw]
from = ["near", "following", "placed", "held", "stopped"]
to = "away"
motion = "retreat"
checks = ["withdraw_possible"]
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"

[branches.placement.operations.following_lost]
from = ["following"]
to = "held"
event = true

[branches.placement.operations.alignment_lost]
from = ["placed"]
to = "held"
event = true
"""

FOLLOWING = parse_blueprint(TEXT.encode(), origin="following.toml")
