"""What the nodes say of their devices: told in the log when it changes, and by refusals for want of poses."""

from __future__ import annotations

import structlog

from pcmrs.devices.poses import PoseFeed
from pcmrs.messages import DeviceHealth
from pcmrs.service.watches.readiness import DeviceReadiness

log = structlog.get_logger(__name__)


class HealthWatch:
    """Takes what the nodes say of their devices.

    Args:
        hearing: Told of devices that are there at the start, or known to be absent.
        poses: Told why the tracker sends none.

    Attributes:
        last: Device to what its node has said of it last.
    """

    def __init__(self, hearing: DeviceReadiness, poses: PoseFeed) -> None:
        self._hearing, self._poses = hearing, poses
        self._absent: dict[str, str] = {}
        self.last: dict[str, DeviceHealth] = {}

    def take(self, _key: str, health: DeviceHealth) -> None:
        """Logs a device that is lost, for another reason than before, or there again."""
        self.last[health.device] = health
        device, before = health.device, self._absent.pop(health.device, None)
        if device == "tracker":
            self._poses.trouble = health.text
        if not health.connected:
            self._absent[device] = health.text
            if before != health.text:
                log.warning("device_not_connected", device=device, reason=health.text)
        elif before is not None:
            log.info("device_connected", device=device)
        self._hearing.hear(device)
