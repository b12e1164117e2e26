"""Start a motion, stop it, acknowledge, and back off. Run place.py first."""

import asyncio

from pcmrs.client import Client


async def main() -> None:
    async with Client.connect() as cell:
        moving = asyncio.create_task(cell.call("placement.approach"))
        running = asyncio.create_task(cell.until(lambda state: bool(state.running)))
        await asyncio.wait((moving, running), return_when=asyncio.FIRST_COMPLETED)
        if moving.done():
            running.cancel()
            reason = moving.result().reason
            raise SystemExit(f"It does not move: {reason.text if reason else moving.result().decision}")
        stop = await cell.stop()
        print(f"approach: {(await moving).decision}")
        print(f"meanwhile: {(await cell.call('placement.approach')).decision}, Stop is latched")
        print(f"acknowledge: {(await cell.acknowledge(stop=stop.number)).decision}")
        print(f"back_off: {(await cell.call('placement.back_off')).decision}")


asyncio.run(main())
