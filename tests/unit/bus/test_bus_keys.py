"""Keys: building, taking apart, the table, and the class of data of each key."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus import KEYS, KeyTable
from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.keys import cell_prefix, command_key, split_command_key
from pcmrs.bus.qos import BEATS, COMMANDS, EVENTS, JOINTS, OTHER, POSES, SETPOINTS, SNAPSHOTS, DataClass, class_of
from pcmrs.devices.link import Link
from pcmrs.errors import PayloadError
from tests.unit.bus.bus_cells import open_pair

chunks = st.from_regex(r"[a-z0-9][a-z0-9._-]{0,20}", fullmatch=True)


@given(chunks, chunks, chunks)
def test_a_command_key_comes_apart_as_it_was_built(user: str, branch: str, operation: str) -> None:
    assert split_command_key(command_key(user, branch, operation)) == (user, branch, operation)


@pytest.mark.parametrize("name", ["", "Upper", "a/b", "*", "a**", "a b", "ä", ".a", "a\n", "$*", "a#", "a?"])
def test_a_name_that_would_change_the_key_is_refused(name: str) -> None:
    with pytest.raises(PayloadError):
        command_key("local", name, "reinit")
    with pytest.raises(PayloadError):
        cell_prefix("lab", name)


@pytest.mark.parametrize(
    ("key", "data"),
    [
        ("cmd/local/robot/connect", COMMANDS),
        ("cmd/*/*/*", COMMANDS),
        ("stop/*", COMMANDS),
        ("state/fsm", SNAPSHOTS),
        ("state/event", EVENTS),
        ("state/joints", JOINTS),
        ("state/pose/coil", POSES),
        ("state/pose/*", POSES),
        ("dev/robot/beat", BEATS),
        ("dev/*/beat", BEATS),
        ("dev/robot/setpoint", SETPOINTS),
        ("dev/robot/event", EVENTS),
        ("dev/robot/state", SNAPSHOTS),
        ("meta/version", OTHER),
        ("state/**", OTHER),
    ],
)
def test_each_key_has_its_class_of_data(key: str, data: DataClass) -> None:
    assert class_of(key) is data


def test_the_table_crosses_the_bus() -> None:
    table = KeyTable(prefix=cell_prefix("lab", "cell1"), keys=KEYS)
    assert unpack(pack(table), KeyTable) == table


async def test_the_bus_is_the_link_that_devices_need() -> None:
    async with open_pair() as (router, _):
        link: Link = router
        assert link is router
