"""The run of the daemon, as its heartbeats name it to processes on other machines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import zenoh

from pcmrs.bus.declare import declare_subscriber
from pcmrs.bus.qos import class_of
from pcmrs.bus.seal import ReplayWindow, Seal
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.errors import SealError

_DAEMON_BEAT: Final = "daemon/beat"
"""Key of the daemon's heartbeats, whose seals name its run."""


def follow_daemon(
    session: zenoh.Session, prefix: str, seal: Seal, on_forged: Callable[[str, SealError], object] | None = None
) -> Any:
    """Let a seal take the run of the daemon from its heartbeats, in Zenoh's thread, until the subscriber is undeclared.

    Args:
        session: Session that subscribes.
        prefix: Key prefix of the cell.
        seal: Seal without a run (`Seal.follows`).
        on_forged: Called in Zenoh's thread with the relative key and the error of a heartbeat that is rejected; None
            to ignore it.

    Returns:
        The subscriber.
    """
    key, taken = f"{prefix}/{_DAEMON_BEAT}", ReplayWindow()

    def take(sample: zenoh.Sample) -> None:
        mark = attached_to(sample)
        try:
            seal.check(mark, ("put",), key, payload_of(sample), taken)
        except SealError as error:
            if on_forged is not None:
                on_forged(_DAEMON_BEAT, error)
        else:
            seal.follow(mark)

    return declare_subscriber(session, key, class_of(_DAEMON_BEAT), take)
