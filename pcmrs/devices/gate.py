"""The gate of a device: it decides which acting requests the device still accepts, so that Stop is final.

Other messages may overtake a request on its way, also the hold of a Stop. So every hold raises the device's hold epoch,
and a request that acts names the epoch for which it was made: one that was sent before the hold and arrives after it is
refused, however late. The number is a fencing token (Kleppmann, *Designing Data-Intensive Applications*, 2017, ch. 8);
the sessions do the same for requests of an earlier daemon and to an earlier node.
"""

from __future__ import annotations

import uuid

from pcmrs.errors import DeviceError
from pcmrs.messages import ActToken, GateState

STALE = "stale_request"
"""Code of the refusal of an acting request that was made for another session or hold epoch than the present ones."""

LATCHED = "device_latched"
"""Code of the refusal of an acting request while the device is latched."""

ACTS: dict[str, frozenset[str]] = {
    "robot": frozenset({"follow", "press", "begin_servo"}),
    "stimulator": frozenset({"set_intensity", "arm", "fire"}),
    "pointer": frozenset({"touch", "touch_surface", "slide"}),
}
"""Acting methods of each device: a request for one of them that was sent before a hold must not act after it."""

HOLDS = {"robot": "hold", "stimulator": "disarm", "pointer": "release"}
"""Method of each device that ends whatever acts."""

HOLD_TIME = 1.0
"""Time within which a held robot stands, and a stimulator is disarmed, s of the machine."""

LATCHING = frozenset({"robot", "stimulator"})
"""Devices that a hold can latch, and that start latched; a pointer has an epoch only."""

RELEASE = "release_latch"
"""Method that ends a device's latch; the node itself serves it."""


class Gate:
    """The gate of one device, in its node. Every change takes effect at once: no method waits.

    Args:
        device: Name of a device in `ACTS`.
        node: Node session: random, one for each start of the node. By default a new one.

    Attributes:
        state: Sessions and epoch that requests must name; heartbeats and replies report it.
    """

    def __init__(self, device: str, node: str | None = None) -> None:
        self._device = device
        self._number = 0
        self.state = GateState(node=node or uuid.uuid4().hex, epoch=0, latched=device in LATCHING)

    def check(self, token: ActToken | None) -> ActToken:
        """Check that a request was made for the present sessions and epoch, and return its token.

        Raises:
            DeviceError: The device is latched (``device_latched``), or the request names another session or epoch
                than the present ones, or none (``stale_request``).
        """
        state = self.state
        if token is None:
            text = f"The {self._device} acts only for requests that name its hold epoch: use the daemon."
            raise DeviceError(text, code=STALE)
        if state.latched:
            text = f"The {self._device} was stopped and is latched: acknowledge the Stop, then ask again."
            raise DeviceError(text, code=LATCHED, epoch=state.epoch)
        named = {"daemon session": token.daemon, "node session": token.node, "epoch": token.epoch}
        present = {"daemon session": state.daemon, "node session": state.node, "epoch": state.epoch}
        differs = [name for name, value in named.items() if value != present[name]]
        if differs:
            text = f"The request is older than the last hold or restart of the {self._device}: another "
            text += f"{' and another '.join(differs)} (epoch {token.epoch}, present {state.epoch}). Ask again."
            raise DeviceError(text, code=STALE, differs=differs, epoch=token.epoch, present=state.epoch)
        return token

    def admit(self, token: ActToken | None) -> None:
        """Admit a request to act; each acts once, and none after a newer one.

        Raises:
            DeviceError: See `check`; or its number is not greater than the last one (``stale_request``).
        """
        token = self.check(token)
        if token.number <= self._number:
            text = f"Request {token.number} of the {self._device} arrived after request {self._number}: ask again."
            raise DeviceError(text, code=STALE, number=token.number, last=self._number)
        self._number = token.number

    def hold(self, *, latch: bool, daemon: str = "") -> None:
        """Raise the epoch, so that no earlier request acts any more.

        Args:
            latch: True if the device is to act only after a release: for Stop, danger, and holds by the node itself.
            daemon: Session of the daemon that holds; a device without latch acts for this one from now on.
        """
        state = self.state
        follows = state.daemon if self._device in LATCHING else (daemon or state.daemon)
        self._change(
            epoch=state.epoch + 1, latched=state.latched or (latch and self._device in LATCHING), daemon=follows
        )

    def release(self, token: ActToken | None) -> None:
        """End the latch; from now on the device acts for the daemon that released it, and for no earlier one.

        Raises:
            DeviceError: The release names another node session or epoch than the newest (``stale_request``): the
                device was held again, or restarted, since the release was decided.
        """
        state = self.state
        if token is None or (token.node, token.epoch) != (state.node, state.epoch):
            text = f"The {self._device} was held or restarted after this release was decided: acknowledge again."
            raise DeviceError(text, code=STALE, present=state.epoch)
        self._change(epoch=state.epoch, latched=False, daemon=token.daemon)

    def forget_daemon(self) -> None:
        """Act for no daemon until one releases the device, because the last one has ended."""
        self._change(epoch=self.state.epoch, latched=self.state.latched, daemon="")

    def _change(self, *, epoch: int, latched: bool, daemon: str) -> None:
        state = self.state
        if daemon != state.daemon:
            self._number = 0  # each daemon counts its own requests
        self.state = GateState(node=state.node, epoch=epoch, latched=latched, daemon=daemon, changes=state.changes + 1)
