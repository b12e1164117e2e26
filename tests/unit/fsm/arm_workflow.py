"""A sound workflow of an arm with two activities, one of which moves the robot."""

from __future__ import annotations

from pcmrs.fsm import Blueprint, parse_blueprint

ARM = """
id = "arm"
version = "1"

[branches.robot]
states = { ready = "connected", off = "not connected" }
[branches.robot.operations.acknowledge]
from = ["ready"]
to = "ready"
unlatches = true
[branches.robot.operations.disconnect]
from = ["ready"]
to = "off"
[branches.robot.operations.connect]
from = ["off"]
to = "ready"
[branches.robot.operations.changed]
from = ["*"]
to = "ready"
iio = true

[branches.arm]
level = 2
emits = { "*" = "changed" }
[branches.arm.states]
away = "clear"
near = "at the body"
following = "moves with the body"
held = "let go"
stopped = "stopped"
[branches.arm.parent]
branch = "robot"
start = "off"
compatible = { away = ["ready", "off"], "*" = ["ready"] }
[branches.arm.activities]
near = { run = "watch_head", ended = "lost_sight" }
following = { run = "follow_head", ended = "lost", moves = true }
[branches.arm.operations.approach]
from = ["away", "held"]
to = "near"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.follow]
from = ["near"]
to = "following"
motion = "approach"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.withdraw]
from = ["near", "following", "held", "stopped"]
to = "away"
motion = "retreat"
steps = ["move"]
on_failure = "stopped"
on_unknown = "stopped"
[branches.arm.operations.lost]
from = ["following"]
to = "held"
event = true
[branches.arm.operations.lost_sight]
from = ["near"]
to = "held"
event = true
[branches.arm.operations.reinit]
from = ["*"]
to = "away"
rio = true
"""


def arm_blueprint() -> Blueprint:
    return parse_blueprint(ARM.encode())
