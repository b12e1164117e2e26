"""Envelopes of the bus, MessagePack and JSON: each input is a message of its kind, or is refused.

python -m fuzz.envelopes -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.bus.codec", "pcmrs.bus._closed_decoder", "pcmrs.messages"):
    from pcmrs.bus.codec import convert_event, error_from, pack, pack_text, unpack
    from pcmrs.bus.commands import Envelope
    from pcmrs.bus.stop import Press
    from pcmrs.errors import PayloadError
    from pcmrs.messages import (
        Beat,
        BlueprintTag,
        BodyPose,
        Command,
        DeviceEvent,
        DeviceReply,
        DeviceRequest,
        DryRunRequest,
        Epoch,
        JointState,
        JournalQuery,
        NextStepRequest,
        NodeBeat,
        PoseMessage,
        Snapshot,
        Target,
        TeleopSetpoint,
        TeleopStatus,
        Verdict,
    )

ARRIVING = (Envelope, Press, DryRunRequest, JournalQuery, NextStepRequest, TeleopSetpoint)
"""Messages of clients to the daemon."""
DEVICES = (Beat, BodyPose, DeviceReply, DeviceRequest, Epoch, JointState, NodeBeat, PoseMessage)
"""Messages between daemon and nodes."""
# Kinds are only appended: the corpus selects them by number.
KINDS = (Command, Verdict, Snapshot, DeviceEvent, BlueprintTag, *ARRIVING, *DEVICES, Target, TeleopStatus)


def one(data: bytes) -> None:
    """Decode a message, whose kind the first byte selects; a decoded message can be encoded."""
    kind, payload = KINDS[data[0] % len(KINDS) if data else 0], data[1:]
    assert error_from(payload).text
    try:
        message = unpack(payload, kind)
    except PayloadError:
        return
    assert isinstance(message, kind)
    try:
        assert unpack(pack(message), kind) == message or payload.lower().count(b"nan")
        pack_text(message)
        convert_event(unpack(payload, dict))
    except PayloadError:
        return


if __name__ == "__main__":
    run(one)
