"""A small workflow with timers: a tool that is left alone, a rest after each pulse, and a reminder that repeats."""

from __future__ import annotations

from pcmrs.fsm import Blueprint, parse_blueprint

TIMED = """
id = "timed"
version = "1"
goal = { tool = ["placed"] }

[defaults.procedure.limits]
rest_s = 5

[branches.tool]
states = { away = "clear of the body", placed = "at the body", held = "left alone at the body" }

[branches.tool.timers]
idle = { states = ["placed"], after_s = 600, posts = "left_alone", restarted_by = ["tool.nudge", "pulse.give"] }

[branches.tool.operations.place]
from = ["away", "held"]
to = "placed"

[branches.tool.operations.nudge]
from = ["placed"]
to = "placed"
steps = ["nudge_tool"]
timeout_s = 5000

[branches.tool.operations.look]
from = ["*"]
to = { away = "away", placed = "placed", held = "held" }
steps = ["look_at_tool"]
timeout_s = 5000

[branches.tool.operations.withdraw]
from = ["placed", "held"]
to = "away"

[branches.tool.operations.left_alone]
from = ["placed"]
to = "held"
event = true

[branches.pulse]
states = { off = "disarmed", ready = "the next pulse may be given", resting = "too soon after the last pulse" }

[branches.pulse.timers]
rest = { states = ["resting"], after_s = "rest_s", posts = "rested" }

[branches.pulse.operations.arm]
from = ["off"]
to = "ready"

[branches.pulse.operations.disarm]
from = ["*"]
to = "off"

[branches.pulse.operations.give]
from = ["ready"]
to = "resting"
affects_patient = true
requires = { tool = ["placed"] }
steps = ["fire"]

[branches.pulse.operations.rested]
from = ["resting"]
to = "ready"
event = true

[branches.session]
states = { closed = "not begun", open = "under way" }

[branches.session.timers]
remind = { states = ["open"], after_s = 60, posts = "reminded", repeat = true }

[branches.session.operations.begin]
from = ["closed"]
to = "open"

[branches.session.operations.end]
from = ["open"]
to = "closed"

[branches.session.operations.reminded]
from = ["open"]
to = "open"
event = true

[branches.session.operations.acknowledge]
from = ["*"]
to = { closed = "closed", open = "open" }
unlatches = true
"""


def timed_blueprint() -> Blueprint:
    """The workflow; it is sound."""
    return parse_blueprint(TIMED.encode())
