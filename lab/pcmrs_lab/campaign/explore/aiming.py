"""Draws a session that aims at race windows, so that events meet that rarely meet by chance.

Random pauses hardly ever hit the milliseconds in which a request is in transit or a row is being written. So a part of
the sessions go straight to a state from which the robot may move. There an operation begins, is interrupted, answered
and changed, each inside windows that are held open or in a cell that is slow. The windows are named by messages and
rows, not by operations: every operation passes them.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

import msgspec

from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.script import Act

DEPTHS = (1, 3, 5, 5, 6, 7, 8, 8)
"""Numbers of steps from the initial state: with 5 the arm may approach, and the last of 8 is done at the body."""
TO_THE_BODY = 7
"""Number of steps after which the tool is at its place."""
TO_FOLLOW = 8
"""Number of steps after which the tool is placed even if one of them was too early, and may follow the head."""
LONG_MOTIONS = ((6, "placement.approach"), (6, "placement.approach"), (8, "placement.home"))
"""Numbers of steps from the initial state, and motions from there that last longer than the deadman's time."""
FOLLOWED = 4.0
"""Longest time for which the tool follows the head before that is interrupted, s."""
MEETINGS = (1, 3)
"""Least and largest number of meetings of a session."""
AFTERWARDS = (2, 4)
"""Least and largest number of further steps after a meeting."""
SOON, LATER = 0.05, 0.6
"""Half of the pauses between aimed acts are shorter than the first, the others than the second, s."""
DURING = 3.0
"""In one of three cases an interruption comes within this, since motions take seconds, s."""
SLOWED = 0.5
"""Share of the meetings that take place while something is slow."""
INTERRUPTED = 0.8
"""Share of the meetings in which the operation is interrupted."""
ANSWERED = 0.8
"""Share of the interruptions that an operator acknowledges and continues after: half at once, half when the arm stands.
"""
STANDS = (0.6, 1.5)
"""Times after which a watching operator has seen that the arm stands, s."""
CHANGED = 0.6
"""Share of the further steps during which something changes."""
INSIDE = 0.5
"""Share of the interruptions that wait for a window; the others come at any moment."""
HELD_UP = 0.4
"""Share of the windows in which the loop of a process is blocked, in addition to the thread that holds the window."""
LONGEST = 0.5
"""Longest time for which a window is held open, s; a third of them are held so long."""

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
    ("start_registrati", ()),
    ("execute_motionxx", ()),
    ("execute_confirmx", ()),
    ("adjust_tranxxxxx", (0.0, 0.0, 0.002)),
    ("execute_bkoffset", ()),
)
"""Commands of clients that only know acknowledgements, in the order of the procedure."""
OF_OPERATIONS = (
    "send:robot.*",
    "reply:robot.*",
    "write:intent:*",
    "written:intent:*",
    "write:outcome:*",
    "written:outcome:*",
)
"""Windows that every operation passes that moves the arm."""
OF_COMMITS = OF_OPERATIONS[-2:]
"""Windows in which an operation has ended but is not committed yet."""
OF_STOPS = (
    "send:robot.hold",
    "reply:robot.hold",
    "write:device:*",
)
"""Windows that Stop and the reports of devices pass."""
EVENTS = (
    *("bump_reference", "bump_reference", "bump_reference"),
    *("push_tool", "e_stop", "drop_client"),
    *("tracker_restart", "frame_ahead"),
)
"""True or false reports of devices about the patient, the robot and the tracker."""
ENDS = ("crash_daemon", "crash_daemon", "crash_node")
"""Faults that end a process."""
SLOW = ("held_up", "delay", "slow_disk", "partition")
"""Faults that make events meet that are in transit in a process, on the network or to the disk."""
LATE = ("delay", "delay", "delay", "held_up")
"""Faults that make the heartbeats of the daemon late."""
SILENCES = ("crash_daemon", "crash_daemon", "crash_daemon", "partition")
"""Faults after which no heartbeat of the daemon arrives any more."""
CHANGES = ("toolplan.clear", "toolplan.plan", "registration.clear_registration", "registration.register")
"""Operations that revoke the basis of a motion."""


def draw_aimed(draw: random.Random) -> list[Act]:
    """Return acts that go straight to some state, and then meet."""
    depth = draw.choice(DEPTHS)
    turns = [(number + 1) % 2 if number < TO_THE_BODY else draw.randrange(3) for number in range(depth)]
    acts = [Act(0.5, "go_on", "anna", {"turn": turn}) for turn in turns]
    for _ in range(draw.randint(*MEETINGS)):
        acts += _meeting(draw)
    return acts


def draw_following(draw: random.Random) -> list[Act]:
    """Return acts that go straight to the body and follow the head there, until that is interrupted."""
    acts = [Act(0.5, "go_on", "anna", {"turn": (number + 1) % 2}) for number in range(TO_FOLLOW)]
    acts.append(Act(0.5, "placement.follow", "anna"))
    first, *others = draw.choice((_end, _end, _stop, _event))(draw)
    acts += [msgspec.structs.replace(first, after=round(draw.uniform(0.0, FOLLOWED), 3)), *others]
    for _ in range(draw.randint(*AFTERWARDS)):
        acts += _afterwards(draw)
    return acts


def draw_silenced(draw: random.Random) -> list[Act]:
    """Return acts that go straight to a long motion, in which messages are late and the daemon becomes silent."""
    depth, motion = draw.choice(LONG_MOTIONS)
    acts = [Act(0.5, "go_on", "anna", {"turn": (number + 1) % 2}) for number in range(depth)]
    acts.append(Act(_pause(draw), motion, "anna", {}, waits=False))
    acts.append(_fault(draw, LATE))
    silence = _fault(draw, SILENCES)
    acts.append(msgspec.structs.replace(silence, after=round(draw.uniform(SOON, DURING), 3)))
    for _ in range(draw.randint(*AFTERWARDS)):
        acts += _afterwards(draw)
    return acts


def _meeting(draw: random.Random) -> list[Act]:
    """Return a meeting: an operation begins, is interrupted and answered; then the procedure continues.

    It takes place in windows, or while something is slow.
    """
    acts = draw.choice((_go_on, _go_on, _move, _old, _nothing))(draw)
    if draw.random() < SLOWED:
        acts.insert(draw.randint(0, min(1, len(acts))), _fault(draw, SLOW))
    if draw.random() < INTERRUPTED:
        interrupts = draw.choice((_stop, _event, _end))(draw)
        acts += _inside(draw, interrupts, OF_OPERATIONS) if draw.random() < INSIDE else _during(draw, interrupts)
        if draw.random() < ANSWERED:
            acts += draw.choice((_answer_at_once, _answer_and_leave))(draw)
    for _ in range(draw.randint(*AFTERWARDS)):
        acts += _afterwards(draw)
    return acts


def _answer_at_once(draw: random.Random) -> list[Act]:
    """Acknowledge while the Stop is pending, and continue."""
    return _inside(draw, [Act(0.0, "robot.acknowledge", "ben")], OF_STOPS) + _go_on(draw)


def _answer_and_leave(draw: random.Random) -> list[Act]:
    """Acknowledge the displayed Stop and retract the tool, while something changes."""
    acts = [Act(round(draw.uniform(*STANDS), 3), "go_on", "ben", {"turn": 1}), *_go_on(draw)]
    return acts + (_inside(draw, _change(draw), OF_COMMITS) if draw.random() < CHANGED else [])


def _afterwards(draw: random.Random) -> list[Act]:
    """Return a further step, mostly with a change inside a window of it."""
    if draw.random() >= CHANGED:
        return [Act(LATER, "go_on", "anna", {"turn": draw.randrange(60)})]
    changed = draw.choice((_change, _change, _change, _stop, _event, _old, _reuse, _go_on))(draw)
    return draw.choice((_go_on, _go_on, _go_on, _old))(draw) + _inside(draw, changed, OF_OPERATIONS)


def _during(draw: random.Random, acts: list[Act]) -> list[Act]:
    after = round(draw.uniform(0.0, draw.choice((SOON, LATER, DURING))), 3)
    return [msgspec.structs.replace(acts[0], after=after), *acts[1:]]


def _inside(draw: random.Random, acts: list[Act], windows: Sequence[str]) -> list[Act]:
    """Return the acts with the first one in the next of these windows."""
    first, *others = [_fault(draw, ("held_up",)), *acts] if draw.random() < HELD_UP else acts
    held = LONGEST if draw.random() < 1.0 / 3.0 else round(draw.uniform(0.0, LONGEST), 3)
    after = round(draw.uniform(0.0, min(held, draw.choice((SOON, LONGEST)))), 3)
    return [Act(after, first.what, first.who, first.arguments, first.waits, draw.choice(windows), held), *others]


def _pause(draw: random.Random) -> float:
    return round(draw.uniform(0.0, draw.choice((SOON, LATER))), 3)


def _go_on(draw: random.Random) -> list[Act]:
    return [Act(_pause(draw), "go_on", "anna", {"turn": draw.randrange(60)}, waits=False)]


def _nothing(_: random.Random) -> list[Act]:
    """Return no act: the meeting is with the operation that is already running."""
    return []


def _move(draw: random.Random) -> list[Act]:
    what, arguments = draw.choice(MOTIONS)
    return [Act(_pause(draw), what, "anna", arguments, waits=False)]


def _old(draw: random.Random) -> list[Act]:
    """Return commands of a client that does not wait for the end of a motion before it sends the next one."""
    first = draw.randrange(len(OLD))
    sent = [OLD[(first + further) % len(OLD)] for further in range(draw.randint(1, 3))]
    return [Act(_pause(draw), f"old:{name}", "ben", {"tokens": list(tokens)}, waits=False) for name, tokens in sent]


def _stop(draw: random.Random) -> list[Act]:
    return [Act(_pause(draw), "stop", "ben")]


def _change(draw: random.Random) -> list[Act]:
    return [Act(_pause(draw), draw.choice(CHANGES), "ben", {}, waits=False)]


def _reuse(draw: random.Random) -> list[Act]:
    return [Act(_pause(draw), f"reuse:{draw.choice(CHANGES)}", "anna", {}, waits=draw.random() < 0.5)]


def _event(draw: random.Random) -> list[Act]:
    return [_fault(draw, EVENTS)]


def _end(draw: random.Random) -> list[Act]:
    return [_fault(draw, ENDS)]


def _fault(draw: random.Random, names: tuple[str, ...]) -> Act:
    name = draw.choice(names)
    fault = FAULTS[name]
    lasts = {} if fault.end is None else {"lasts": round(draw.uniform(0.2, min(3.0, fault.lasts)), 3)}
    return Act(_pause(draw), f"fault:{name}", "", fault.draw(draw) | lasts, waits=False)
