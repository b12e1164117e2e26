"""The library that public clients use reads three visible tools."""

from __future__ import annotations

import asyncio
import json
import sys

import msgspec
import pytest

from pcmrs_sim.ndi.protocol import Lines
from pcmrs_sim.tracker_faults import BODIES
from tests.unit.sim.ndi.ndi_talk import POSE, Talk

CLIENT = """
import json, sys
import ndicapy

device = ndicapy.ndiOpenNetwork("127.0.0.1", int(sys.argv[1]))

def ask(command):
    try:
        ndicapy.ndiCommand(device, command)
    except UnicodeDecodeError:
        pass  # a reply of 128 bytes or more is no UTF-8; it was parsed before

ask("INIT:")
handles = []
for number in range(3):
    ask("PHRQ:*********1****")
    handles.append(ndicapy.ndiGetPHRQHandle(device))
    ask(f"PVWR:{handles[-1]:02X}0000" + "01" * 64)
    ask(f"PINIT:{handles[-1]:02x}")
    ask(f"PENA:{handles[-1]:02x}D")
ask("TSTART:")
ask(sys.argv[2])
read = ndicapy.ndiGetBXTransform if sys.argv[2].startswith("BX") else ndicapy.ndiGetTXTransform
print(json.dumps([read(device, bytes((handle,))) for handle in handles]))
ask("TSTOP:")
ndicapy.ndiCloseNetwork(device)
"""


@pytest.mark.parametrize("command", ["BX:0801", "TX:0801"])
async def test_the_library_reads_three_visible_tools(command: str) -> None:
    talk = Talk([msgspec.structs.replace(POSE, body=body) for body in BODIES])

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        lines = Lines()
        while data := await reader.read(4096):
            writer.write(b"".join(talk.system.answer(line) for line in lines.feed(data)))
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = str(server.sockets[0].getsockname()[1])
    client = await asyncio.create_subprocess_exec(
        sys.executable, "-c", CLIENT, port, command, stdout=asyncio.subprocess.PIPE
    )
    output, _ = await client.communicate()
    server.close()
    expected = [*POSE.quat_wxyz, *(1000.0 * value for value in POSE.position)]
    tools = json.loads(output)
    assert len(tools) == 3
    for tool in tools:
        assert tool[:7] == pytest.approx(expected, abs=0.01)
