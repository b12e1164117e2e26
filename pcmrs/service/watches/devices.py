"""Health of the devices as their nodes report it: logged when it changes, and part of refusals without poses."""

from __future__ import annotations

import structlog

from pcmrs.devices.poses import PoseFeed
from pcmrs.messages import DeviceHealth
from pcmrs.service.watches.readiness import DeviceReadiness

log = structlog.get_logger(__name__)


class HealthWatch:
    """Watch over the health of the devices.

    Args:
        readiness: Readiness of the devices, which the first health of a device completes.
        poses: Pose feed, which reports why the tracker sends no poses.

    Attributes:
        last: Device to its newest health.
    """

    def __init__(self, readiness: DeviceReadiness, poses: PoseFeed) -> None:
        self._readiness, self._poses = readiness, poses
        self._absent: dict[str, str] = {}
        self.last: dict[str, DeviceHealth] = {}

    def take(self, _key: str, health: DeviceHealth) -> None:
        """Follow the health of a device; log if it is lost, for another reason than before, or back again.

        Args:
            _key: Key of the message.
            health: The health.
        """
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
        self._readiness.record_message(device)
