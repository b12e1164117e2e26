"""Discovery of cells: who is connected, by cell, at one router."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.bus import Bus
from pcmrs.bus.cells import find_cells
from pcmrs.errors import BusError, ConfigurationError
from tests.unit.bus.bus_cells import new_cell, open_bus, plain_session, sync


async def test_components_are_listed_by_cell_and_in_order() -> None:
    settings = new_cell()
    async with open_bus(settings) as router:
        other = msgspec.structs.replace(settings, mode="client", cell=f"{settings.cell}b")
        async with open_bus(other) as node:
            for name in ("robot", "daemon"):
                router.alive(name)
            node.alive("tracker")
            with plain_session(settings) as session:
                session.put("pcmrs/test/c0/alive/coil", b"a message is no token")
                found = await find_cells(msgspec.structs.replace(settings, mode="client"))
    here, there = f"test/{settings.cell}", f"test/{other.cell}"
    assert list(found.items()) == [(here, ["daemon", "robot"]), (there, ["tracker"])]


async def test_a_component_that_has_left_is_not_listed() -> None:
    settings = new_cell()
    client = msgspec.structs.replace(settings, mode="client")
    async with open_bus(settings) as router:
        router.alive("daemon")
        node = await Bus.open(client)
        node.alive("robot")
        await sync(router, node)
        assert (await find_cells(client))[f"test/{settings.cell}"] == ["daemon", "robot"]
        await node.close()
        assert (await find_cells(client))[f"test/{settings.cell}"] == ["daemon"]


async def test_without_a_router_the_endpoint_is_named() -> None:
    settings = msgspec.structs.replace(new_cell(), mode="client")
    with pytest.raises(BusError) as error:
        await find_cells(settings)
    assert error.value.fields["endpoint"] == settings.endpoint


async def test_a_far_endpoint_requires_a_certificate() -> None:
    far = msgspec.structs.replace(new_cell(), mode="client", endpoint="tls/192.0.2.7:7447")
    with pytest.raises(ConfigurationError, match="requires a certificate"):
        await find_cells(far)
