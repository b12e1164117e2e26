"""Execution of commands: in uvloop if it is installed, with errors as one readable line and an exit status."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec, TypeVar

import click

from pcmrs.cli.printing import say, say_lines
from pcmrs.errors import (
    AccessError,
    BlueprintError,
    BusError,
    ConfigurationError,
    PcmrsError,
    UnknownOutcomeError,
)
from pcmrs.extras import missing_module

if TYPE_CHECKING:
    import asyncio

P = ParamSpec("P")
T = TypeVar("T")

EXIT_REJECTED = 1
EXIT_USAGE = 2
"""Of a wrong command line; click has the same."""
EXIT_NO_DAEMON = 3
EXIT_BAD_CONFIGURATION = 4
EXIT_FAILED = 5
EXIT_UNKNOWN = 6
"""It cannot be known what has happened."""

STATUS: list[tuple[type[PcmrsError], int]] = [
    (AccessError, EXIT_REJECTED),
    (BusError, EXIT_NO_DAEMON),
    (ConfigurationError, EXIT_BAD_CONFIGURATION),
    (BlueprintError, EXIT_BAD_CONFIGURATION),
    (UnknownOutcomeError, EXIT_UNKNOWN),
]


def run(work: Coroutine[Any, Any, T]) -> T:
    """Run `work` in its own event loop."""
    import asyncio  # help does not need it

    with asyncio.Runner(loop_factory=_loop_factory()) as runner:
        return runner.run(work)


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    try:
        import uvloop  # not needed for help, and not installed without the extra daemon
    except ModuleNotFoundError:
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory


def readable_errors(function: Callable[P, T]) -> Callable[P, T]:
    """Return a command whose errors end in a line on standard error and an exit status, never in a traceback."""

    @functools.wraps(function)
    def command(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            return function(*args, **kwargs)
        except PcmrsError as error:
            fail(error)
        except ModuleNotFoundError as error:
            fail_missing(error)
        except BrokenPipeError:
            raise  # the reader of the output is closed: click ends silently
        except OSError as error:
            place = "" if error.filename is None else f"{error.filename}: "
            say(f"{click.get_current_context().command_path}: {place}{error.strerror or error}", err=True)
            sys.exit(EXIT_FAILED)
        except KeyboardInterrupt:
            sys.exit(130)

    return command


def fail_missing(error: ModuleNotFoundError) -> NoReturn:
    """End the process with what to install; raise the error if its module belongs to no extra."""
    missing = missing_module(error)
    if missing is None:
        raise error
    fail(missing)


def fail(error: PcmrsError, status: int | None = None) -> NoReturn:
    """End the process with the error's text and status.

    Args:
        error: The error.
        status: Exit status; None for that of the error's kind.
    """
    say_problem(error.text)
    sys.exit(next((its for kind, its in STATUS if isinstance(error, kind)), EXIT_FAILED) if status is None else status)


def say_problem(text: str) -> None:
    """Print what is wrong on standard error, after the command's name.

    Further lines are indented, so that a line break in a value from outside cannot forge a message.

    Args:
        text: The problem, and what to do.
    """
    first, *rest = text.splitlines() or [""]
    say(f"{click.get_current_context().command_path}: {first}", err=True)
    say_lines((f"  {line}" if line else "" for line in rest), err=True)
