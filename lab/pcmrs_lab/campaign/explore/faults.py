"""All faults of a simulated session, by name, with the random arguments that they are drawn with."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

BODIES = ("coil", "body_ref", "pointer", "witness")

Draw = Callable[[random.Random], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class RandomFault:
    """One kind of fault.

    Attributes:
        rows: Rows of the fault catalogue.
        draw: Function that draws its arguments.
        end: Arguments that end it; None for one that ends by itself.
        lasts: Longest time until it is ended, s.
        weight: Relative frequency with which it is drawn.
    """

    rows: tuple[str, ...]
    draw: Draw
    end: Mapping[str, Any] | None = None
    lasts: float = 20.0
    weight: float = 1.0


def _nothing(_: random.Random) -> dict[str, Any]:
    return {}


def _on(_: random.Random) -> dict[str, Any]:
    return {"on": True}


def _body(draw: random.Random) -> dict[str, Any]:
    return {"body": draw.choice(BODIES), "on": True}


def _two_bodies(draw: random.Random) -> dict[str, Any]:
    first, second = draw.sample(BODIES, 2)
    return {"first": first, "second": second, "on": True}


def _switched(*rows: str, weight: float = 1.0, lasts: float = 20.0) -> RandomFault:
    return RandomFault(rows, _on, {"on": False}, lasts, weight)


def _of_body(*rows: str) -> RandomFault:
    return RandomFault(rows, _body, {"on": False})


SCENE: Mapping[str, RandomFault] = {
    "cut_robot": _switched("B1", weight=2.0),
    "silence_robot": _switched("B2"),
    "interrupt": RandomFault(("B3",), _nothing),
    "frame_replies": RandomFault(("B4",), lambda draw: {"how": draw.choice(("mixed", "split", "merged", "whole"))}),
    "e_stop": _switched("B5", weight=2.0),
    "offset_joint": RandomFault(
        ("B7",), lambda draw: {"joint": draw.randint(1, 7), "angle": draw.uniform(-0.1, 0.1)}, {"angle": 0.0}
    ),
    "change_mode": _switched("B8"),
    "close_brakes": _switched("B8"),
    "guide_by_hand": RandomFault(("B9",), lambda draw: {"joint": draw.randint(1, 7), "angle": draw.uniform(-0.2, 0.2)}),
    "refuse_robot": _switched("B10"),
    "drop_client": RandomFault(("B11",), _nothing),
    "late_set_point": _switched("B12"),
    "double_commands": _switched("B13"),
    "push_tool": RandomFault(("B14", "S13"), lambda draw: {"force": draw.uniform(-40.0, 40.0)}, {"force": 0.0}, 3.0),
    "withdraw_servo": _switched("B15"),
    "restart_cabinet": RandomFault(("B11",), _nothing),
    "occlude": _of_body("S1"),
    "frame_frozen": _switched("S2"),
    "pose_nan": _of_body("S3"),
    "pose_not_unit": _of_body("S4"),
    "pose_jump": RandomFault(
        ("S5",),
        lambda draw: {"body": draw.choice(BODIES), "millimetres": draw.uniform(-200.0, 200.0)},
        {"millimetres": 0.0},
    ),
    "not_measured": RandomFault(
        ("S7",),
        lambda draw: {"body": draw.choice(BODIES), "reason": draw.choice(("out_of_volume", "temperature")), "on": True},
        {"on": False},
    ),
    "bad_fit": _of_body("S7"),
    "phantom_marker": _of_body("S8"),
    "tool_swap": RandomFault(("S8",), _two_bodies, {"on": False}),
    "wrong_tool": _of_body("S9"),
    "tracker_rate": RandomFault(("S10",), lambda draw: {"hertz": draw.choice((0.5, 1.0, 2.0))}, {"hertz": 0.0}),
    "stamp_reversed": _switched("S11"),
    "stamp_future": _switched("S11"),
    "tracker_unplugged": _switched("S2"),
    "tracker_absent": _switched("S2"),
    "bump_reference": RandomFault(("S6",), lambda draw: {"millimetres": draw.uniform(-20.0, 20.0)}, weight=2.0),
    "shift_body": RandomFault(("S5", "B6"), lambda draw: {"millimetres": draw.uniform(-60.0, 60.0)}),
    "dash_head": RandomFault(("S12",), lambda draw: {"millimetres_per_second": draw.uniform(0.0, 150.0)}),
    "no_mep": _switched("S14"),
    "preactivation": RandomFault(("S14",), lambda draw: {"microvolts": draw.uniform(0.0, 300.0)}, {"microvolts": 0.0}),
}  # fmt: skip
"""Faults that the simulated scene injects, under its names for them."""

ENDPOINTS = ("operator", "daemon", "node")


def _ends(draw: random.Random) -> dict[str, Any]:
    one, other = draw.sample(ENDPOINTS, 2)
    return {"from": one, "to": other, "both": draw.random() < 0.5}


NETWORK: Mapping[str, RandomFault] = {
    "loss": RandomFault(("N1",), lambda draw: {"part": draw.choice((0.05, 0.2))}, {"part": 0.0}),
    "duplicates": RandomFault(("N2", "O10"), lambda draw: {"part": draw.choice((0.2, 0.5))}, {"part": 0.0}, weight=2.0),
    "reordering": RandomFault(("N3",), lambda draw: {"part": draw.choice((0.2, 0.5))}, {"part": 0.0}),
    "delay": RandomFault(("N4",), lambda draw: {"seconds": round(draw.uniform(0.05, 0.5), 3)}, {"seconds": 0.0}),
    "partition": RandomFault(("N9", "N13"), _ends, {}, 10.0, 2.0),
}
"""Faults that the simulated network injects."""

HOST: Mapping[str, RandomFault] = {
    "crash_daemon": RandomFault(("P1",), _nothing, {}, 10.0, 3.0),
    "end_daemon": RandomFault(("P2",), _nothing, {}, 10.0),
    "crash_node": RandomFault(("P1",), _nothing, {}, 5.0, 2.0),
    "held_up": RandomFault(
        ("T4",),
        lambda draw: {"process": draw.choice(("daemon", "node")), "seconds": round(draw.uniform(0.02, 0.5), 3)},
        weight=2.0,
    ),
    "tracker_restart": RandomFault(("S11",), _nothing),
    "frame_ahead": RandomFault(("S11",), _nothing),
    "slow_disk": RandomFault(
        ("T8",), lambda draw: {"seconds": draw.choice((0.05, 0.5, 2.0))}, {"seconds": 0.0}, weight=2.0
    ),
    "failing_disk": RandomFault(("T1", "T2", "T3"), lambda draw: {"landing": draw.random() < 0.5}, {}, 5.0),
    "wall_jump": RandomFault(
        ("C1", "C2"), lambda draw: {"seconds": draw.choice((-3600.0, 864000.0))}, {"seconds": 0.0}
    ),
    "wall_frozen": _switched("C3"),
    "skewed_operator": RandomFault(
        ("C4",), lambda draw: {"seconds": draw.choice((-30.0, 3.0, 60.0))}, {"seconds": 0.0}
    ),
}
"""Faults of the processes of daemon and node, of their hosts, and between the tracker and its node."""

DETECTOR: Mapping[str, RandomFault] = {
    "hand_enters": RandomFault((), _nothing, {}, 10.0),
    "camera_silent": RandomFault((), _nothing, {}, 10.0),
    "camera_frozen": RandomFault((), _nothing, {}, 10.0),
    "camera_occluded": RandomFault((), _nothing, {}, 10.0),
    "event_flood": RandomFault((), _nothing, {}, 3.0),
}
"""What a detector sees, and how it fails; only in sessions with a watched scene."""

FAULTS: Mapping[str, RandomFault] = {**SCENE, **NETWORK, **HOST}
"""All faults; a script names one as ``fault:<name>``."""
