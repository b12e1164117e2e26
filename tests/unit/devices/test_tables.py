"""The first steps of a driver: its table of the configuration, and the devices that it is to open."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import pytest

from pcmrs.devices.tables import check_devices, check_names, read_table
from pcmrs.errors import ConfigurationError


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Table of a driver."""

    host: str = "10.0.0.1"
    rate_hz: Annotated[float, msgspec.Meta(gt=0.0)] = 50.0


def test_absent_table_and_absent_values_are_the_defaults() -> None:
    assert read_table({"other": {"host": "elsewhere"}}, "lab", Table) == Table()
    assert read_table({"lab": {"rate_hz": 20}}, "lab", Table) == Table(rate_hz=20.0)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"hots": "a"}, "hots"),
        ({"host": 3}, r"\$.host"),
        ({"rate_hz": 0.0}, r"\$.rate_hz"),
        ({"rate_hz": "fast"}, r"\$.rate_hz"),
        ([], "object"),
    ],
)
def test_a_wrong_table_is_refused_with_its_name_and_its_key(table: Any, says: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"The table \[lab\] of the configuration is wrong: .*{says}"):
        read_table({"lab": table}, "lab", Table)


def test_a_device_that_the_driver_does_not_serve_is_named() -> None:
    check_devices("lab", ["tracker"], "tracker")
    check_devices("lab", [], "tracker")
    with pytest.raises(ConfigurationError, match="serves tracker only, not emg, robot") as error:
        check_devices("lab", ["robot", "tracker", "emg"], "tracker")
    assert error.value.fields["unknown"] == ["emg", "robot"]


@pytest.mark.parametrize("names", [{}, {"coil": "a", "pointer": "a"}, {"coil": "a", "body_ref": "b", "pointer": "b"}])
def test_bodies_without_own_names_are_refused(names: dict[str, str]) -> None:
    """Two bodies under one name would take each other's poses."""
    with pytest.raises(ConfigurationError, match="give every body its own topic") as error:
        check_names("ros2.topics", names, "topic")
    assert error.value.fields["names"] == names
    check_names("ros2.topics", {"coil": "a", "pointer": "b"}, "topic")
