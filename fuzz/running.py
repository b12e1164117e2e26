"""How a target is run: by libFuzzer, with its options on the command line, or by the test suite, without atheris."""

from __future__ import annotations

import asyncio
import inspect
import logging
import sys
import tempfile
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import structlog

CORPUS = Path(__file__).parent / "corpus"
"""A folder for each target; its files are where libFuzzer starts, and tests."""

SLOWEST = 60
"""An input that takes longer is a defect, s."""

MOST_MEMORY = 8192
"""Of the whole process, MB. Under atheris, and not without it, the target of KST grows with each input."""
MOST_AT_ONCE = 2048
"""One allocation of more than this is a defect, MB."""

Target = Callable[[bytes], Awaitable[None] | None]

_MAIN = Path(getattr(sys.modules["__main__"], "__file__", None) or "-")


def instrumented(*packages: str) -> AbstractContextManager[object]:
    """What is imported inside tells libFuzzer its branches; where a corpus is only replayed, nothing is changed."""
    if _MAIN.parent != CORPUS.parent:
        return nullcontext()
    import atheris

    context: AbstractContextManager[object] = atheris.instrument_imports(include=list(packages))
    return context


def run(target: Target) -> None:
    """Feed inputs to the target of the main module until one raises.

    ``-runs=N`` and ``-max_total_time=S`` on the command line end it earlier. Inputs that reach something new are kept
    in the folder that the command line names first, otherwise in a temporary one; the input that raised, in the corpus.
    Where the command line names files, they are replayed and nothing else is done.

    Args:
        target: Raises what is a defect.
    """
    import atheris

    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    corpus, named = CORPUS / _MAIN.stem, [Path(each) for each in sys.argv[1:] if not each.startswith("-")]
    options = [f"-artifact_prefix={corpus}/", f"-timeout={SLOWEST}", f"-report_slow_units={SLOWEST}"]
    options += [f"-rss_limit_mb={MOST_MEMORY}", f"-malloc_limit_mb={MOST_AT_ONCE}"]
    folders = [] if named else [tempfile.mkdtemp(prefix="fuzz-")]
    folders += [] if any(each.is_file() for each in named) else [str(corpus)]
    with asyncio.Runner() as runner:
        atheris.Setup([sys.argv[0], *options, *sys.argv[1:], *folders], _in_loop(runner, target))
        atheris.Fuzz()


def feed(target: Target, data: bytes) -> None:
    """Feed one input to a target. Raises what is a defect."""
    with asyncio.Runner() as runner:
        _in_loop(runner, target)(data)


def pieces(data: bytes) -> list[bytes]:
    """The rest of the data cut where its first bytes say, as a network may."""
    count, rest = (data[0] % 8, data[1:]) if data else (0, b"")
    sizes, rest = rest[:count], rest[count:]
    found = []
    for size in sizes:
        found.append(rest[:size])
        rest = rest[size:]
    return [*found, rest]


def _in_loop(runner: asyncio.Runner, target: Target) -> Callable[[bytes], None]:
    """All inputs of a coroutine in one event loop, where what one has left behind is done before the next."""
    loop = runner.get_loop()

    def one(data: bytes) -> None:
        result = target(data)
        if inspect.isawaitable(result):
            loop.run_until_complete(_awaited(result))

    return one


async def _awaited(result: Awaitable[None]) -> None:
    await result
