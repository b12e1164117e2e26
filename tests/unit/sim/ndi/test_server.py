"""The virtual tracker on a socket."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.clock import SystemClock
from pcmrs_sim.cell import running_cell
from pcmrs_sim.faults import inject
from pcmrs_sim.ndi.protocol import reply
from pcmrs_sim.ndi.server import serve_ndi


async def test_replies_come_over_a_socket_however_the_commands_are_cut() -> None:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        reader, writer = await asyncio.open_connection(host, port)
        async with asyncio.timeout(10.0):
            writer.write(b"INIT:E3A5\rINI")
            assert await reader.readuntil(b"\r") == b"OKAYA896\r"
            writer.write(b"T:E3A5\rBEEP 1\r")
            assert await reader.readuntil(b"\r") == b"OKAYA896\r"
            assert await reader.readuntil(b"\r") == reply("1")
            writer.close()
            await writer.wait_closed()


async def test_a_tracker_that_is_as_if_absent_answers_nothing() -> None:
    async with running_cell({}, SystemClock()) as cell, serve_ndi(cell) as (host, port):
        inject(cell, "tracker_absent", {"on": True})
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(b"INIT:E3A5\r")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await reader.read(1)
        inject(cell, "tracker_absent", {"on": False})
        writer.write(b"BEEP 1\r")
        async with asyncio.timeout(10.0):
            assert await reader.readuntil(b"\r") == reply("1")
            writer.close()
            await writer.wait_closed()
