"""Attacks are declared by rows and recorded by the code that sends; a difference is described."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.bus.keys import KEYS
from pcmrs_lab.campaign import tries
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.tries import ADMIN, BUS, ROS_POSES, WILDCARDS, Try, declared, difference, record, recorded_tries


async def test_tasks_and_threads_of_the_context_are_recorded() -> None:
    with recorded_tries() as tried:
        record("flood", "UDP", "TCP")
        await asyncio.create_task(asyncio.to_thread(record, "viewer", "UDP"))
    record("router", "UDP")
    assert tried == {Try("UDP", "flood"), Try("TCP", "flood"), Try("UDP", "viewer")}


def test_nothing_is_recorded_in_a_sham_campaign() -> None:
    with recorded_tries() as tried, sham():
        record("flood", "UDP")
    assert tried == set()


def test_a_difference_names_what_is_missing_and_what_is_new() -> None:
    wanted = declared({"flood": ["UDP", "TCP"], "viewer": ["UDP"]})
    assert difference(wanted, set(wanted)) == ""
    assert difference(wanted, {Try("UDP", "flood"), Try("UDP", "router")}) == (
        "Declared, but not tried: TCP by flood, UDP by viewer. Tried, but not declared: UDP by router."
    )
    assert difference(frozenset(), {Try("UDP", "router")}) == "", "a row that declares nothing is not compared"


@pytest.mark.parametrize(
    ("key", "way"),
    [
        ("pcmrs/lab/cell1/cmd/anna/robot/connect", tries.COMMANDS),
        ("stop/anna", tries.STOP),
        ("pcmrs/lab/cell1/teleop/tom", tries.SETPOINTS),
        ("scene/camera1", tries.SCENE_EVENTS),
        ("svc/setup/anna", tries.QUERIES),
        ("daemon/beat", tries.DEVICES),
        ("state/pose/coil", tries.STREAMS),
        ("ros2/tracker/coil", ROS_POSES),
        ("ros2/tf", tries.STREAMS),
        ("pcmrs/lab/*/stop/*", WILDCARDS),
        ("**", WILDCARDS),
        ("@/*/router/config/adminspace/enabled", ADMIN),
    ],
)
def test_a_key_belongs_to_an_entry_point(key: str, way: str) -> None:
    assert tries.way_of(key) == way


def test_every_key_of_the_table_belongs_to_an_entry_point() -> None:
    ways = {tries.way_of(row.key) for row in KEYS if not row.key.startswith("alive/")}
    assert ways == {*BUS, ROS_POSES}
