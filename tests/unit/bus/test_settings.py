"""Settings of a process on the bus, and why its session cannot be opened."""

import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.codec import MAX_BYTES
from pcmrs.errors import AccessError, BusError, ConfigurationError
from pcmrs.messages.identity import EVERY_CELL, Identity
from pcmrs.pki import Authority, read_credentials
from pcmrs.testing.daemon import free_port
from tests.unit.bus.bus_cells import new_cell, open_bus


async def test_a_second_daemon_is_refused() -> None:
    settings = new_cell()
    async with open_bus(settings):
        with pytest.raises(BusError, match="another daemon") as error:
            await Bus.open(settings)
        assert error.value.fields["endpoint"] == settings.endpoint
    # A closed one frees the endpoint.
    async with open_bus(settings):
        pass


async def test_client_without_a_daemon_is_told_to_start_one() -> None:
    with pytest.raises(BusError, match="start pcmrs-serve"):
        await Bus.open(msgspec.structs.replace(new_cell(), mode="client"))


async def test_refused_certificate_holder_gets_the_possible_causes(tmp_path: Path) -> None:
    now = time.time()
    Authority.init(tmp_path / "pki", "lab", now).issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path)
    endpoint = f"tls/127.0.0.1:{free_port()}"
    settings = BusSettings(endpoint=endpoint, credentials=read_credentials(tmp_path / "anna", now))
    with pytest.raises(BusError, match=f"No router at {endpoint} accepts anna: none runs there, its certificate"):
        await Bus.open(settings)


def test_a_link_takes_no_more_than_the_decoder_and_an_envelope() -> None:
    largest = BusSettings().zenoh_config()["transport/link/rx/max_message_size"]
    assert MAX_BYTES < largest < 1.01 * MAX_BYTES


def test_the_administration_of_a_router_is_read_only_and_off() -> None:
    settings = BusSettings(mode="router").zenoh_config()
    assert settings["adminspace/permissions"] == {"read": True, "write": False}
    assert "adminspace/enabled" not in settings, "it is off by default"


@pytest.mark.parametrize("endpoint", ["tcp/192.0.2.7:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/robot.local:1"])
def test_endpoint_open_to_other_machines_needs_certificates(endpoint: str) -> None:
    """Also for a router: without certificates it listens on loopback only."""
    for open_to_others in (BusSettings(endpoint=endpoint), BusSettings(mode="router", endpoint=endpoint)):
        with pytest.raises(ConfigurationError, match="without certificates") as error:
            open_to_others.zenoh_config()
        assert error.value.fields["endpoint"] == endpoint
    for more in (BusSettings(mode="router", listen=(endpoint,)), BusSettings(mode="router", routers=(endpoint,))):
        with pytest.raises(ConfigurationError, match="must begin with tls/"):
            more.zenoh_config()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, None),
        ({"name": "eve"}, "unknown"),
        ({"revoked": 5.0}, "revoked"),
        ({"ends": 9.0}, "expired"),
        ({"begins": 11.0}, "expired"),
        ({"cells": ("lab/cell2",)}, "foreign"),
        ({"cells": ("lab/*",)}, None),
    ],
)
def test_a_user_who_may_not_take_part_is_refused_with_why(change: dict[str, Any], why: str | None) -> None:
    anna = Identity(name="anna", role="operator", serial="1", begins=0.0, ends=20.0, cells=EVERY_CELL)
    settings = BusSettings(members=(msgspec.structs.replace(anna, **change),))
    if why is None:
        assert settings.member("anna", 10.0).role == "operator"
        return
    with pytest.raises(AccessError) as error:
        settings.member("anna", 10.0)
    assert (error.value.fields["why"], error.value.fields["user"]) == (why, "anna")


@pytest.mark.parametrize("endpoint", ["127.0.0.1:7447", "tcp/127.0.0.1", "tcp/:7447x", "tcp/127.0.0.1:port"])
def test_an_endpoint_without_protocol_or_port_is_refused(endpoint: str) -> None:
    """Zenoh's own error came out as a traceback, also of `pcmrs stop`."""
    for mode in ("client", "router"):
        with pytest.raises(ConfigurationError, match="write protocol, host and port"):
            BusSettings(mode=mode, endpoint=endpoint).zenoh_config()
