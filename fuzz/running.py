"""Runs a target: by libFuzzer, with its options on the command line, or by the test suite, without atheris."""

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
"""Folder with a corpus for each target: the start of libFuzzer, and test cases."""

SLOWEST = 60
"""Time above which an input counts as a defect, s."""

MOST_MEMORY = 8192
"""Limit for the whole process, MB. Under atheris, and only there, the target of KST grows with each input."""
MOST_AT_ONCE = 2048
"""Size above which a single allocation counts as a defect, MB."""

Target = Callable[[bytes], Awaitable[None] | None]

_MAIN = Path(getattr(sys.modules["__main__"], "__file__", None) or "-")


def instrumented(*packages: str) -> AbstractContextManager[object]:
    """Instrument imports inside the context for libFuzzer; do nothing if a corpus is only replayed."""
    if _MAIN.parent != CORPUS.parent:
        return nullcontext()
    import atheris

    context: AbstractContextManager[object] = atheris.instrument_imports(include=list(packages))
    return context


def run(target: Target) -> None:
    """Feed inputs to the target of the main module until one raises.

    ``-runs=N`` and ``-max_total_time=S`` on the command line end it earlier. Inputs that reach new code are stored in
    the first folder of the command line, or in a temporary one; the input that raised is stored in the corpus. If the
    command line names files, they are only replayed.

    Args:
        target: Target, which raises an error for a defect.
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
    """Feed one input to a target, which raises an error for a defect.

    Args:
        target: Target.
        data: Input.
    """
    with asyncio.Runner() as runner:
        _in_loop(runner, target)(data)


class UploadedFile:
    """File with the input of a target, in a temporary folder.

    Args:
        names: Names that the file may have.
    """

    def __init__(self, *names: str) -> None:
        self._names = names
        self._folder = tempfile.TemporaryDirectory(prefix="fuzz-")

    def write(self, data: bytes) -> Path:
        """Write an input without its first byte, which selects the name of the file; return its path."""
        path = Path(self._folder.name, self._names[data[0] % len(self._names) if data else 0])
        path.write_bytes(data[1:])
        return path


def pieces(data: bytes) -> list[bytes]:
    """Return the rest of the data, cut at positions that its first bytes select, like packets of a network."""
    count, rest = (data[0] % 8, data[1:]) if data else (0, b"")
    sizes, rest = rest[:count], rest[count:]
    found = []
    for size in sizes:
        found.append(rest[:size])
        rest = rest[size:]
    return [*found, rest]


def _in_loop(runner: asyncio.Runner, target: Target) -> Callable[[bytes], None]:
    """Return a function that runs all inputs in one event loop, so that leftovers end before the next one."""
    loop = runner.get_loop()

    def one(data: bytes) -> None:
        result = target(data)
        if inspect.isawaitable(result):
            loop.run_until_complete(_awaited(result))

    return one


async def _awaited(result: Awaitable[None]) -> None:
    await result
