"""A conversation with the virtual tracker without its socket."""

from __future__ import annotations

from collections.abc import Sequence

from pcmrs.devices.ndi.tools import placeholder
from pcmrs.messages import BodyPose
from pcmrs_sim.ndi.protocol import crc16
from pcmrs_sim.ndi.system import NdiSystem

POSE = BodyPose(
    body="coil",
    frame_number=258,
    captured=0.0,
    sent=0.0,
    valid=True,
    position=(-0.0389, 0.58617, -1.23456),
    quat_wxyz=(0.5, -0.5, 0.5, -0.5),
    error=0.00012,
)
UNSEEN = BodyPose(body="pointer", frame_number=258, captured=0.0, sent=0.0, valid=False, reason="occluded")


def command_line(command: str) -> bytes:
    """As the library sends it: with a CRC behind what follows a colon."""
    return command.encode() + (f"{crc16(command.encode()):04X}".encode() if ":" in command else b"")


class Talk:
    """A system that sees `poses`, and the text of its answers."""

    def __init__(self, poses: Sequence[BodyPose] = (POSE, UNSEEN)) -> None:
        self.plugged = True
        self.poses = poses
        self.system = NdiSystem(lambda: self.poses, lambda: self.plugged)

    def raw(self, command: str) -> bytes:
        return self.system.answer(command_line(command))

    def ask(self, command: str) -> str:
        """The answer without its CRC, which is checked."""
        answer = self.raw(command)
        assert answer.endswith(b"\r")
        assert answer[-5:-1] == f"{crc16(answer[:-5]):04X}".encode()
        return answer[:-5].decode()

    def load(self, srom: bytes) -> str:
        handle = self.ask("PHRQ:*********1****")
        for start in range(0, len(srom), 64):
            assert self.ask(f"PVWR:{handle}{start:04X}{srom[start : start + 64].ljust(64, bytes(1)).hex()}") == "OKAY"
        assert self.ask(f"PINIT:{handle}") == "OKAY"
        assert self.ask(f"PENA:{handle}D") == "OKAY"
        return handle

    def track(self, *bodies: str) -> None:
        assert self.ask("INIT:") == "OKAY"
        for body in bodies:
            self.load(placeholder(body))
        assert self.ask("TSTART:") == "OKAY"
