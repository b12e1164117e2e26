"""Markers on Lab Streaming Layer: what the procedure does, on the time axis of everything else that a lab records."""

from __future__ import annotations

from pcmrs.devices.lsl.markers import MarkerOutlet
from pcmrs.messages import DeviceEvent, Snapshot, Verdict

STOP = "stop"


class Markers:
    """Marks every change of a state as ``branch:from->to``, every Stop as ``stop`` and every pulse as ``pulse:3``.

    The mark of a pulse comes when its operation has ended: when it was given is marked by the stimulator's driver.

    Args:
        stream: Name of the stream.
        now: How things are; changes from there on are marked.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, stream: str, now: Snapshot) -> None:
        self._outlet = MarkerOutlet(stream)
        self._branches = now.branches

    def show(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Marks what is new in something that the daemon publishes; never waits."""
        if isinstance(message, Snapshot):
            for branch, state in message.branches.items():
                before = self._branches.get(branch)
                if before != state:
                    self._outlet.push(f"{branch}:{before}->{state}")
            self._branches = message.branches
        elif isinstance(message, Verdict) and message.result and "pulse" in message.result:
            self._outlet.push(f"pulse:{message.result['pulse']}")

    def stop(self) -> None:
        """Marks a Stop."""
        self._outlet.push(STOP)
