"""Print decisions, device events and state changes of a cell until Ctrl-C: watch.py [SECONDS]."""

import asyncio
import sys
from contextlib import suppress

from pcmrs.client import Client
from pcmrs.messages import DeviceEvent, Snapshot, Verdict


async def main(seconds: float | None) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(seconds), Client.connect() as cell:
            async for event in cell.watch():
                match event:
                    case Snapshot():
                        print("  ".join(f"{branch}={state}" for branch, state in event.branches.items()))
                    case Verdict():
                        print(f"{event.branch}.{event.operation}: {event.decision}")
                    case DeviceEvent():
                        print(f"{event.device}: {event.text}")


asyncio.run(main(float(sys.argv[1]) if len(sys.argv) > 1 else None))
