"""Free space under the journal: a warning first, then typed refusals, and Stop and events go on."""

from __future__ import annotations

from pathlib import Path

from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent, Reason
from pcmrs.service.watches.space import SpaceWatch


class Daemon:
    """What the watch tells the dispatcher."""

    def __init__(self, folder: Path) -> None:
        self.suspended: Reason | None = None
        self.events: list[DeviceEvent] = []
        self.watch = SpaceWatch(folder, 1000.0, 100.0, self.suspend, self.events.append, SystemClock())

    def suspend(self, reason: Reason | None) -> None:
        self.suspended = reason

    @property
    def codes(self) -> list[str]:
        return [event.code for event in self.events]


def test_low_disk_warns_once_then_refuses_and_recovers(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path)
    for free in (5000.0, 900.0, 800.0):
        daemon.watch.take(free)
    assert daemon.codes == ["disk_filling"]
    assert daemon.suspended is None

    daemon.watch.take(99.0)
    daemon.watch.take(98.0)
    assert daemon.codes == ["disk_filling", "disk_full"]
    assert daemon.suspended is not None
    assert daemon.suspended.code == "disk_full"
    assert daemon.suspended.fields["free_mb"] == 99.0
    assert "Make room" in daemon.suspended.text
    assert not any(event.danger for event in daemon.events)

    daemon.watch.take(500.0)
    assert daemon.suspended is None
    daemon.watch.take(2000.0)
    assert daemon.codes == ["disk_filling", "disk_full", "disk_filling", "disk_has_room"]
