""""""

from __future__ import annotations

import pytest

from pcmrs.devices.calls import PROTOCOLS
from pcmrs.devices.opening import check_conformity
from pcmrs.errors import ConfigurationError


class HalfATracker:
    trouble = ""


def test_missing_item_is_named() -> None:
    with pytest.raises(ConfigurationError, match="'lab' has a tracker without frames: implement") as raised:
        check_conformity("lab", {"tracker": HalfATracker()})
    assert raised.value.fields == {"driver": "lab", "device": "tracker", "lacking": ["frames"]}


def test_a_robot_must_have_what_its_node_asks_beside_its_methods() -> None:
    with pytest.raises(ConfigurationError) as raised:
        check_conformity("lab", {"robot": object()})
    needed = {"follow", "hold", "states", "events", "set_point", "trouble", "dropped"}
    assert needed <= set(raised.value.fields["lacking"])


@pytest.mark.parametrize("name", PROTOCOLS)
def test_device_that_implements_the_protocol_is_accepted(name: str) -> None:
    protocol = PROTOCOLS[name]
    check_conformity("lab", {name: type("Whole", (protocol,), {})()})
