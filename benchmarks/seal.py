"""Cost of the seal of daemon and device nodes, for each message and at the rates of a cell.

Measures sealing and checking one message with joints and one with a pose, in one thread, and a bare HMAC of the same
bytes.

    .venv/bin/python benchmarks/seal.py [--count 200000] [--json]
"""

from __future__ import annotations

import argparse
import hmac
import json
import platform
import time
from collections.abc import Callable

from pcmrs.bus.codec import pack
from pcmrs.bus.seal import ReplayWindow, Seal, new_key, new_run
from pcmrs.messages import BodyPose, JointState

JOINTS = pack(
    JointState(captured=1.5, sent=1.5, positions=[0.1] * 7, velocities=[0.1] * 7, torques=[0.1] * 7, moving=True)
)
POSE = pack(BodyPose(body="coil", frame_number=7, captured=1.5, sent=1.5, valid=True, position=(0.1, 0.2, 0.3)))
MESSAGES = {"state/joints": JOINTS, "state/pose/coil": POSE}
RATE = 1000.0
"""Messages per second for which the share of a processor is stated."""


def per_call(call: Callable[[int], object], count: int) -> float:
    """Return the processor time of one call, us.

    Args:
        call: Function; it gets the number of the call.
        count: Number of calls.
    """
    started = time.thread_time()
    for number in range(count):
        call(number)
    return (time.thread_time() - started) / count * 1e6


def measure(name: str, payload: bytes, count: int) -> dict[str, float]:
    """Return the processor time for one message on a key, us, and the share of a processor at `RATE`, %.

    Args:
        name: Key below the prefix of the cell.
        payload: Bytes of the message.
        count: Number of messages.
    """
    key = new_key()
    run = key + new_run()
    sender, receiver, taken, absolute = Seal(run), Seal(run, daemon=True), ReplayWindow(), f"pcmrs/lab/cell1/{name}"
    marks = [sender.put("put", absolute, payload) for _ in range(count)]
    found = {
        "bare HMAC": per_call(lambda _: hmac.digest(key, payload, "sha256"), count),
        "seal": per_call(lambda _: sender.put("put", absolute, payload), count),
        "check": per_call(lambda number: receiver.check(marks[number], ("put",), absolute, payload, taken), count),
    }
    found["share at 1 kHz, %"] = (found["seal"] + found["check"]) * RATE / 1e4
    return {"bytes": len(payload)} | {each: round(value, 2) for each, value in found.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=200_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = {name: measure(name, payload, options.count) for name, payload in MESSAGES.items()}
    if options.json:
        print(json.dumps(found))
        return
    print(f"{platform.platform()}, Python {platform.python_version()}; processor time in us")
    for name, values in found.items():
        print(f"  {name:<16}", "  ".join(f"{each} {value:g}" for each, value in values.items()))


if __name__ == "__main__":
    main()
