"""Envelopes of the bus, MessagePack and JSON: a message of its kind, or refused.

python -m fuzz.envelopes -max_total_time=60
"""

from __future__ import annotations

import atheris

from fuzz.running import run

with atheris.instrument_imports(include=["pcmrs.bus.codec", "pcmrs.messages"]):
    from pcmrs.bus.codec import pack, pack_text, unpack
    from pcmrs.errors import PayloadError
    from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Snapshot, Verdict

KINDS = (Command, Verdict, Snapshot, DeviceEvent, BlueprintTag)


def one(data: bytes) -> None:
    """The first byte chooses the kind; what is taken can be sent on."""
    kind, payload = KINDS[data[0] % len(KINDS) if data else 0], data[1:]
    try:
        message = unpack(payload, kind)
    except PayloadError:
        return
    assert isinstance(message, kind)
    try:
        assert unpack(pack(message), kind) == message or payload.lower().count(b"nan")
        pack_text(message)
    except PayloadError:
        return


if __name__ == "__main__":
    event = DeviceEvent(device="coil", code="lost", text="Not seen.", fields={"count": 3, "at": [0.5]})
    run(
        one, b"\x03" + pack(event), b"\x03" + pack_text(event), b'\x00{"arguments": {"index": 0}}', b"\x00\x81\xa1a\xc0"
    )
