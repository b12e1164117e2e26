"""Publishers and subscribers with the quality of service of their class of data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import zenoh
from zenoh import CongestionControl, Locality, ext

from pcmrs.bus.qos import DataClass

_ENCODING: Final = "application/msgpack"

_HEARTBEAT: Final = 0.2
"""Seconds after which a subscriber learns that it missed the last message."""


def declare_publisher(session: zenoh.Session, key: str, data: DataClass) -> zenoh.Publisher | ext.AdvancedPublisher:
    """A publisher on an absolute key whose ``put`` never waits for the link."""
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
    """A subscriber to what other sessions publish on an absolute key expression.

    Args:
        session: That hears.
        key: Absolute key expression.
        data: Its class; of kept data, lost messages are recovered and late subscribers get the history.
        receive: Called in a thread of Zenoh's.
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
