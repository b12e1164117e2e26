"""Envelopes of the bus, MessagePack and JSON: each input is a message of its kind, or is refused.

python -m fuzz.envelopes -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.bus.codec", "pcmrs.messages"):
    from pcmrs.bus.codec import pack, pack_text, unpack
    from pcmrs.errors import PayloadError
    from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Snapshot, Verdict

KINDS = (Command, Verdict, Snapshot, DeviceEvent, BlueprintTag)


def one(data: bytes) -> None:
    """Decode a message, whose kind the first byte selects; a decoded message can be encoded."""
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
    run(one)
