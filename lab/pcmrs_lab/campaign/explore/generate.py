"""Draws a session: operators mostly do the next step of the procedure, sometimes not, while faults happen."""

from __future__ import annotations

import random

from pcmrs.fsm import Blueprint
from pcmrs_lab.campaign.explore.aiming import draw_aimed, draw_following, draw_silenced
from pcmrs_lab.campaign.explore.faults import DETECTOR, FAULTS
from pcmrs_lab.campaign.explore.plans import GARBAGE, random_operation
from pcmrs_lab.campaign.explore.script import Act, Physics, SessionScript

OPERATORS = ("anna", "ben")
SECOND = 0.15
"""Share of the acts of the second operator."""
FEWEST, MOST = 12, 30
"""Least and largest number of acts of a session."""
CODED = 0.25
"""Share of the sessions in which every message is packed and unpacked."""
AIMED = 0.75
"""Share of the sessions that aim at windows."""
FOLLOWING = 0.05
"""Share of the sessions that follow the head; drawn separately, so that a seed of another session keeps its acts."""
SILENCED = 0.05
"""Share of the sessions whose daemon becomes silent in a motion; drawn separately, too."""
WATCHED = 0.05
"""Share of the sessions in which a detector watches the scene; drawn separately, likewise."""
FEWEST_EVENTS, MOST_EVENTS = 1, 6
"""Least and largest number of what happens in a watched scene."""
SLOW = (0.0, 0.0, 0.1, 0.3)
"""Shares of the windows that take time by themselves; one for each session."""
IN_THE_MIDDLE = 0.3
"""Share of the commands that are not waited for, so that the next act comes while they run."""

PAUSE = 20.0
"""Mean pause of an operator after a command has ended without a fault, s; one in ten is a long one."""
LONG_PAUSE = 120.0
HURRY = 4.0
"""Mean time until the next act while a command runs or a fault is present, s."""
BRIEF = 1.5
"""Largest pause before a fault or Stop, s."""


def draw_script(blueprint: Blueprint, workflow: str, seed: int, physics: Physics = "kinematic") -> SessionScript:
    """Return the session of a seed.

    Args:
        blueprint: Blueprint of the workflow.
        workflow: Name of the workflow.
        seed: Seed of everything that is random.
        physics: Physics of the simulated arm.
    """
    draw = random.Random(f"session {workflow} {seed}")
    coded, slow = draw.random() < CODED, draw.choice(SLOW)
    separate = random.Random(f"following {workflow} {seed}")
    if separate.random() < FOLLOWING:
        acts = draw_following(separate)
    elif separate.random() < SILENCED:
        acts = draw_silenced(separate)
    elif draw.random() < AIMED:
        acts = draw_aimed(draw)
    else:
        acts = _draw_any(blueprint, draw)
    of_scene = random.Random(f"scene {workflow} {seed}")
    scene = of_scene.random() < WATCHED
    if scene:
        acts = draw_scene(acts, of_scene)
    return SessionScript(seed=seed, workflow=workflow, physics=physics, coded=coded, slow=slow, scene=scene, acts=acts)


def draw_scene(acts: list[Act], draw: random.Random) -> list[Act]:
    """Return acts with random events of a watched scene among them.

    Args:
        acts: Acts of the session.
        draw: Source of randomness.
    """
    acts = list(acts)
    for _ in range(draw.randint(FEWEST_EVENTS, MOST_EVENTS)):
        name = draw.choice(list(DETECTOR))
        lasts = round(draw.uniform(0.2, DETECTOR[name].lasts), 3)
        event = Act(round(draw.uniform(0.0, BRIEF), 3), f"fault:{name}", "", {"lasts": lasts}, waits=False)
        acts.insert(draw.randint(0, len(acts)), event)
    return acts


def _draw_any(blueprint: Blueprint, draw: random.Random) -> list[Act]:
    trouble = draw.choice((0.0, 0.1, 0.25, 0.4))
    acts: list[Act] = []
    for _ in range(draw.randint(FEWEST, MOST)):
        acts.append(_act(blueprint, draw, trouble, hurry=bool(acts) and not acts[-1].waits))
    return acts


def _act(blueprint: Blueprint, draw: random.Random, trouble: float, *, hurry: bool) -> Act:
    waits = draw.random() >= IN_THE_MIDDLE
    mean = HURRY if hurry else LONG_PAUSE if draw.random() < 0.1 else PAUSE
    after = round(draw.expovariate(1.0 / mean), 3)
    if draw.random() < trouble:
        return _fault(draw)
    who = OPERATORS[draw.random() < SECOND]
    kind = draw.random()
    if kind < 0.72:
        return Act(after, "go_on", who, {"turn": draw.randrange(60)}, waits)
    if kind < 0.84:
        what, arguments = random_operation(blueprint, draw)
        return Act(after, what, who, arguments, waits)
    if kind < 0.90:
        return Act(round(draw.uniform(0.0, BRIEF), 3), "stop", who)
    if kind < 0.95:
        return Act(after, "repeat", who, {}, waits)
    return Act(after, "datagram", who, {"number": draw.randrange(len(GARBAGE))})


def _fault(draw: random.Random) -> Act:
    names = list(FAULTS)
    (name,) = draw.choices(names, [FAULTS[each].weight for each in names])
    fault = FAULTS[name]
    lasts = {} if fault.end is None else {"lasts": round(draw.uniform(0.2, fault.lasts), 3)}
    return Act(round(draw.uniform(0.0, BRIEF), 3), f"fault:{name}", "", fault.draw(draw) | lasts, waits=False)
