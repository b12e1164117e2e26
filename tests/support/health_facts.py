"""What a daemon finds of itself when all is well, for tests that make one thing ill."""

from __future__ import annotations

from pcmrs.messages import BlueprintTag
from pcmrs.messages.health import (
    DeviceStatus,
    HealthFacts,
    JournalStatus,
    LatencyStatus,
    LoopStatus,
    NodeStatus,
    QueueStatus,
    TaskStanding,
)

WELL = HealthFacts(
    uptime=3725.0,
    versions={"pcmrs": "0.1.0", "python": "3.11.7"},
    blueprint=BlueprintTag(id="ratms", version="1.0.0", hash="0123456789abcdef"),
    latched=False,
    fail_stop="",
    in_doubt=False,
    recording="",
    console="",
    metrics="",
    certificate=None,
    journal=JournalStatus(waiting=1, oldest_wait=0.002, free=5e9),
    tasks=[
        TaskStanding(name="journal", answers=True, restarts=0),
        TaskStanding(name="reference watch", answers=True, restarts=2),
    ],
    nodes=[NodeStatus(driver="sim", devices=["robot", "tracker"], restarts=1, given_up=False)],
    devices=[
        DeviceStatus(device="emg", connected=True),
        DeviceStatus(device="robot", connected=True, heard=0.02, data=0.01, dropped={"beats": 3}),
        DeviceStatus(device="tracker", connected=True, heard=0.02, data=0.03),
    ],
    loop=LoopStatus(lag=0.001, stalls=4, longest=0.3),
    queues=[QueueStatus(queue="bus", depth=2, limit=256, refused=5), QueueStatus(queue="journal", depth=1, limit=4096)],
    strays=6,
    datagrams=7,
    dropped={"bus.replaced": 8},
    decisions={"accepted": 9, "rejected": 10, "failed": 0, "unknown": 0},
    rejections={"busy": 10},
    latencies=[
        LatencyStatus(decision="accepted", count=3, sum=0.6, p50=0.1, p99=0.4, buckets=[(0.25, 2), (0.5, 3)]),
    ],
)
