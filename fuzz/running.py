"""How a target is run: by libFuzzer, with its options on the command line."""

from __future__ import annotations

import asyncio
import logging
import sys
import tempfile
from collections.abc import Awaitable, Callable
from pathlib import Path

import atheris
import structlog

Target = Callable[[bytes], None]


def run(target: Target, *seeds: bytes) -> None:
    """Feeds inputs to the target until one raises, or as often as ``-runs=N`` or long as ``-max_total_time=S`` says.

    Args:
        target: Raises what is a defect.
        *seeds: Inputs to begin with: what most bytes lead nowhere without.
    """
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    for number, seed in enumerate(seeds):
        (folder / str(number)).write_bytes(seed)
    atheris.Setup([*sys.argv, str(folder)], target)
    atheris.Fuzz()


def in_loop(target: Callable[[bytes], Awaitable[None]]) -> Target:
    """The target of a coroutine, all in one event loop."""
    loop = asyncio.new_event_loop()
    asyncio.set_event_loop(loop)

    def one(data: bytes) -> None:
        loop.run_until_complete(_awaited(target(data)))

    return one


async def _awaited(result: Awaitable[None]) -> None:
    await result


def pieces(data: bytes) -> list[bytes]:
    """The rest of the data cut where its first bytes say, as a network may."""
    count, rest = (data[0] % 8, data[1:]) if data else (0, b"")
    sizes, rest = rest[:count], rest[count:]
    found = []
    for size in sizes:
        found.append(rest[:size])
        rest = rest[size:]
    return [*found, rest]
