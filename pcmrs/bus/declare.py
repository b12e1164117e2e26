"""Declaration of publishers and subscribers with the quality of service of their class of data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import zenoh
from zenoh import CongestionControl, Locality, ext

from pcmrs.bus.qos import DataClass

_ENCODING: Final = "application/msgpack"

_HEARTBEAT: Final = 0.2
"""Time after which a subscriber detects that it missed the last message, s."""


def declare_publisher(session: zenoh.Session, key: str, data: DataClass) -> zenoh.Publisher | ext.AdvancedPublisher:
    """Declare a publisher whose ``put`` never waits for the link.

    Args:
        session: Session that publishes.
        key: Absolute key.
        data: Class of the data on this key.
    """
    settings: dict[str, Any] = {
        "encoding": _ENCODING,
        "congestion_control": CongestionControl.DROP,
        "priority": data.priority,
        "express": data.express,
    }
    if not data.kept:
        return session.declare_publisher(key, **settings)
    return ext.declare_advanced_publisher(
        session,
        key,
        **settings,
        cache=ext.CacheConfig(data.kept),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT),
        publisher_detection=True,
    )


def declare_subscriber(
    session: zenoh.Session, key: str, data: DataClass, receive: Callable[[zenoh.Sample], None]
) -> Any:
    """Declare a subscriber to what other sessions publish.

    Args:
        session: Session that subscribes.
        key: Absolute key expression.
        data: Class of the data on this key. Where publishers keep messages, lost ones are recovered and late
            subscribers get the history.
        receive: Called in one of Zenoh's threads with each sample.
    """
    if not data.kept:
        return session.declare_subscriber(key, receive, allowed_origin=Locality.REMOTE)
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=data.history) if data.history else None
    return ext.declare_advanced_subscriber(
        session,
        key,
        receive,
        allowed_origin=Locality.REMOTE,
        history=history,
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
