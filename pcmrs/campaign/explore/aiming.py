"""Draws the end of a session that is aimed at windows: what must not meet is made to meet.

Random pauses hardly ever hit the milliseconds in which a request is on its way or a row is being written. So a part of
the sessions go straight to a state from which something moves, and then act inside windows that are held open.
"""

from __future__ import annotations

import random
from typing import Any

from pcmrs.campaign.explore.faults import FAULTS
from pcmrs.campaign.explore.script import Act

STRAIGHT = 10
"""Steps that lead from nothing to the tool at its place."""
SHORT = 0.6
"""Longest pause between acts that are aimed, s."""
DIRECTED = 0.3
"""Part of the meetings that follow a known course to their windows."""
LONGEST = 0.5
"""A window is held open so long at most, s."""

MOTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("placement.approach", {}),
    ("placement.confirm", {}),
    ("placement.press", {}),
    ("placement.nudge", {"translation": [0.0, 0.0, 0.002]}),
    ("placement.follow", {}),
    ("placement.back_off", {}),
    ("placement.home", {}),
)
OLD: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("execute_motionxx", ()),
    ("execute_confirmx", ()),
    ("adjust_tranxxxxx", (0.0, 0.0, 0.002)),
    ("execute_bkoffset", ()),
    ("start_registrati", ()),
    ("get_jnt_angsxxxx", ()),
)
"""Commands of clients that only know acknowledgements."""
WINDOWS = (
    "send:robot.follow",
    "send:robot.follow",
    "send:robot.press",
    "send:robot.begin_servo",
    "send:robot.hold",
    "send:robot.hold",
    "reply:robot.*",
    "write:intent:placement.*",
    "write:outcome:placement.*",
    "write:outcome:placement.back_off",
    "write:outcome:*",
    "write:*:registration.*",
    "write:*:toolplan.*",
    "write:device:*",
    "written:intent:placement.*",
    "written:outcome:*",
    "written:device:*",
)
EVENTS = ("bump_reference", "push_tool", "cut_robot", "e_stop", "interrupt", "drop_client")
"""What makes devices report something."""
HOSTS = (
    "crash_daemon",
    "crash_daemon",
    "crash_node",
    "held_up",
    "held_up",
    "slow_disk",
    "failing_disk",
    "delay",
    "delay",
    "partition",
)
"""What goes wrong in processes and between them."""
TRACKER = ("tracker_restart", "frame_ahead")
CHANGES = (
    "toolplan.clear",
    "toolplan.plan",
    "registration.clear_registration",
    "registration.register",
    "robot.acknowledge",
    "robot.acknowledge",
)


def draw_aimed(draw: random.Random) -> list[Act]:
    """Acts that go straight to some state, and then meet in windows."""
    depth = draw.randint(3, STRAIGHT - 2)
    acts = [Act(0.5, "go_on", "anna", {"turn": turn}) for turn in (1, 0, 1, 0, 1, 0, 1, 0)[:depth]]
    for _ in range(draw.randint(1, 4)):
        acts += _meeting(draw)
    return acts


def _meeting(draw: random.Random) -> list[Act]:
    """Something begins, others act inside its windows, and somebody goes on."""
    acts = [draw.choice((_move, _move, _move, _old, _event))(draw)]
    if draw.random() < DIRECTED:
        acts = draw.choice((_retreat_after_stop, _answered_late, _followed, _silenced))(draw)
    for _ in range(draw.randint(1, 3)):
        act = draw.choice((_stop, _change, _change, _event, _host, _move, _old, _go_on, _reuse))(draw)
        acts.append(_inside(draw, act) if draw.random() < 0.6 else act)
    acts += [_go_on(draw) for _ in range(draw.randint(0, 3))]
    return acts


def _retreat_after_stop(draw: random.Random) -> list[Act]:
    """What began is stopped and taken back, as people do it, to where its plan is in force again."""
    retreat = Act(_pause(draw), draw.choice(("placement.back_off", "placement.to_initial")), "anna", {}, waits=False)
    acknowledged = Act(1.0 + _pause(draw), "robot.acknowledge", "ben")
    return [_move(draw), _stop(draw), acknowledged, retreat, *(_inside(draw, _change(draw)) for _ in range(2))]


def _answered_late(draw: random.Random) -> list[Act]:
    """The daemon has no time between the acknowledgement of an old client's command and its result."""
    asked = Act(_pause(draw), "old:start_registrati", "ben", {"tokens": []}, waits=False)
    return [asked, _inside(draw, _fault(draw, ("held_up",)), "write:*:registration.*")]


def _followed(draw: random.Random) -> list[Act]:
    """The tool follows the body, and something goes wrong in a process."""
    steps = [
        Act(_pause(draw), what, "anna") for what in ("placement.approach", "placement.confirm", "placement.follow")
    ]
    going_wrong = _host(draw)
    return [*steps, Act(2.0 + _pause(draw), going_wrong.what, "", going_wrong.arguments, waits=False)]


def _silenced(draw: random.Random) -> list[Act]:
    """Something moves while the daemon falls silent behind a network that delays."""
    return [_move(draw), _fault(draw, ("delay",)), _fault(draw, ("crash_daemon", "held_up", "partition"))]


def _inside(draw: random.Random, act: Act, window: str = "") -> Act:
    window, held = window or draw.choice(WINDOWS), round(draw.uniform(0.0, LONGEST), 3)
    after = round(draw.uniform(0.0, held), 3)
    return Act(after, act.what, act.who, act.arguments, act.waits, window, held)


def _pause(draw: random.Random) -> float:
    return round(draw.uniform(0.0, SHORT), 3)


def _move(draw: random.Random) -> Act:
    what, arguments = draw.choice(MOTIONS)
    return Act(_pause(draw), what, "anna", arguments, waits=False)


def _old(draw: random.Random) -> Act:
    name, tokens = draw.choice(OLD)
    return Act(_pause(draw), f"old:{name}", "ben", {"tokens": list(tokens)}, waits=False)


def _go_on(draw: random.Random) -> Act:
    return Act(_pause(draw), "go_on", "anna", {"turn": draw.randrange(60)}, draw.random() < 0.5)


def _stop(draw: random.Random) -> Act:
    return Act(_pause(draw), "stop", "ben")


def _change(draw: random.Random) -> Act:
    return Act(_pause(draw), draw.choice(CHANGES), "ben", {}, waits=False)


def _reuse(draw: random.Random) -> Act:
    return Act(_pause(draw), f"reuse:{draw.choice(CHANGES)}", "anna", {}, waits=draw.random() < 0.5)


def _event(draw: random.Random) -> Act:
    return _fault(draw, EVENTS if draw.random() < 0.9 else TRACKER)


def _host(draw: random.Random) -> Act:
    return _fault(draw, HOSTS)


def _fault(draw: random.Random, names: tuple[str, ...]) -> Act:
    name = draw.choice(names)
    fault = FAULTS[name]
    lasts = {} if fault.mend is None else {"lasts": round(draw.uniform(0.2, min(3.0, fault.lasts)), 3)}
    return Act(_pause(draw), f"fault:{name}", "", fault.draw(draw) | lasts, waits=False)
