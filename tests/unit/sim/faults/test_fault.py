"""The registry of faults, and the lines that ask for them."""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ARMS
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.faults import FAULTS, find_fault, inject, parse_fault
from pcmrs_sim.faults.fault import choice, number, switch
from pcmrs_sim.settings import SimSettings

pytest.importorskip("mujoco")


def test_every_fault_belongs_to_a_row_and_says_what_happens() -> None:
    for name, fault in FAULTS.items():
        assert fault.name == name
        assert re.fullmatch("[a-z][a-z_]*", name)
        assert re.fullmatch("[BS][1-9][0-9]?", fault.row)
        assert fault.help
        assert "\n" not in fault.help


def test_fault_rows_that_the_devices_can_cause_are_there() -> None:
    rows = {fault.row for fault in FAULTS.values()}
    assert {"B1", "B2", "B3", "B4", "B5", "B7", "B8", "B9", "B11", "B13", "B14"} <= rows
    assert {"S1", "S2", "S3", "S4", "S5", "S6", "S7", "S8", "S10", "S11", "S12", "S14"} <= rows


@pytest.mark.parametrize(
    ("line", "name", "arguments"),
    [
        ("cut_robot on", "cut_robot", {"on": True}),
        ("cut_robot off\n", "cut_robot", {"on": False}),
        ("e_stop", "e_stop", {}),
        ("occlude coil on", "occlude", {"body": "coil", "on": True}),
        ("offset_joint 3 -0.05", "offset_joint", {"joint": 3.0, "angle": -0.05}),
        ("frame_replies split", "frame_replies", {"how": "split"}),
        ("push_tool nan", "push_tool", {"force": "nan"}),
    ],
)
def test_a_line_is_a_fault_and_its_arguments(line: str, name: str, arguments: dict[str, Any]) -> None:
    assert parse_fault(line) == (name, arguments)


def test_an_unknown_fault_is_refused() -> None:
    with pytest.raises(DeviceError, match="no fault 'cut_everything'") as refusal:
        find_fault("cut_everything")
    assert refusal.value.fields == {"fault": "cut_everything"}


def test_too_many_words_are_refused_with_the_usage() -> None:
    with pytest.raises(DeviceError, match="write: cut_robot <on>"):
        parse_fault("cut_robot on now")


@pytest.mark.parametrize(
    ("fault", "arguments"),
    [
        ("cut_robot", {"on": "yes"}),
        ("cut_robot", {"off": True}),
        ("offset_joint", {"joint": 3}),
        ("offset_joint", {"joint": 8, "angle": 0.1}),
        ("offset_joint", {"joint": 1.5, "angle": 0.1}),
        ("offset_joint", {"joint": 1, "angle": True}),
        ("push_tool", {"force": 1e6}),
        ("push_tool", {"force": float("nan")}),
        ("frame_replies", {"how": "backwards"}),
        ("frame_replies", {"how": ["split"]}),
        ("dash_head", {"millimetres_per_second": -1.0}),
        ("nothing", {}),
    ],
)
async def test_the_scene_refuses_what_it_cannot_use(
    cell: Mapping[str, Any], fault: str, arguments: dict[str, Any]
) -> None:
    with pytest.raises(DeviceError):
        await cell["scene"].inject(fault, arguments)


async def test_the_scene_cuts_the_robot_by_the_same_registry(cell: Mapping[str, Any]) -> None:
    await cell["scene"].inject("cut_robot", {"on": True})
    with pytest.raises(Exception, match="does not answer"):
        await cell["robot"].connect()
    await cell["scene"].cut_robot(False)
    await cell["robot"].connect()


@pytest.fixture(scope="module")
def still_cell() -> CellSimulation:
    return CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(force_limit=math.inf), SystemClock())


@settings(deadline=None)
@given(
    st.builds(" ".join, st.tuples(st.sampled_from(sorted(FAULTS)), st.text(max_size=20))) | st.text(max_size=40),
)
def test_a_line_is_a_fault_or_is_refused(still_cell: CellSimulation, line: str) -> None:
    if not line.strip():
        return  # such lines are passed over
    with suppress(DeviceError):
        inject(still_cell, *parse_fault(line))


def test_a_switch_is_on_unless_it_says_otherwise() -> None:
    assert switch({}, "on")
    assert not switch({"on": False}, "on")
    with pytest.raises(DeviceError, match="The argument on is 1, must be on or off") as refused:
        switch({"on": 1}, "on")
    assert refused.value.fields == {"argument": "on", "value": 1}


@given(st.floats(allow_nan=True) | st.integers())
def test_a_number_is_within_its_range_or_refused_with_it(value: float) -> None:
    if -2.0 <= value <= 3.0:
        assert number({"size": value}, "size", -2.0, 3.0) == value
    else:
        with pytest.raises(DeviceError, match=r"must be a number from -2 to 3\.") as refused:
            number({"size": value}, "size", -2.0, 3.0)
        assert (refused.value.fields["lowest"], refused.value.fields["highest"]) == (-2.0, 3.0)


@pytest.mark.parametrize("value", [None, True, "2", [2.0]])
def test_what_is_no_number_is_refused(value: Any) -> None:
    with pytest.raises(DeviceError, match="The argument size is"):
        number({"size": value}, "size", -2.0, 3.0)


def test_a_choice_is_refused_with_the_words_that_are_known() -> None:
    assert choice({"how": "split"}, "how", ("split", "whole")) == "split"
    with pytest.raises(DeviceError, match="is 'both', must be one of split, whole"):
        choice({"how": "both"}, "how", ("split", "whole"))
