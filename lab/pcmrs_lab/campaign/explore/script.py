"""What happens in one simulated session, as data: it is drawn, run, shrunk, saved and run again.

Makes a failing script short: delta debugging over its acts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from pcmrs.errors import ConfigurationError

Physics = Literal["kinematic", "mujoco"]


class Act(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One thing that somebody does, or that goes wrong.

    Attributes:
        after: Since the act before was begun, or ended where it is waited for, s.
        what: ``go_on`` (do what leads on from here), ``stop``, ``repeat``, ``datagram``, ``wire:<command>``,
            ``<branch>.<operation>``, ``reuse:<branch>.<operation>`` (under the id of the last command),
            ``old:<command>`` (without an id, as clients do that only know acknowledgements), or ``fault:<name>``.
        who: The operator; for faults nobody.
        arguments: Of the operation, the command or the fault.
        waits: Whether the next act comes only after its verdict.
        window: Done in the next window of this name, `after` s after it opens; see `pcmrs_sim.deterministic.windows`.
        held: That window lasts so long at least, s.
    """

    after: float
    what: str
    who: str = ""
    arguments: dict[str, Any] = {}
    waits: bool = True
    window: str = ""
    held: float = 0.0


class SessionScript(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A whole session.

    Attributes:
        seed: Of the network, of all simulated errors and of identifiers.
        workflow: By its name.
        physics: Of the simulated arm.
        coded: Whether every message is packed and unpacked.
        slow: Part of the windows that take time although no act asks for it.
        acts: In order.
    """

    seed: int
    workflow: str = "ratms"
    physics: Physics = "kinematic"
    coded: bool = False
    slow: float = 0.0
    acts: list[Act] = []


def read_script(path: Path) -> SessionScript:
    """A script from its file.

    Raises:
        ConfigurationError: It cannot be read or is no script.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=SessionScript)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{path} is no script of a session: {error}.", file=str(path)) from None


def write_script(script: SessionScript, path: Path) -> None:
    """Writes a script, so that people can read and change it."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(script), indent=1) + b"\n")


MOST_RUNS = 200
"""Nobody waits for a shorter script than this many runs find."""


def shrink(script: SessionScript, fails: Callable[[SessionScript], bool], most: int = MOST_RUNS) -> SessionScript:
    """The shortest script found that still fails: no act of it can be left out alone, unless `most` was too few.

    Zeller, Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE TSE 2002, without the tests of single
    parts, which hardly ever fail by themselves here.

    Args:
        script: That fails.
        fails: Whether a script fails in the same way.
        most: Runs.
    """
    acts, parts, runs = list(script.acts), 2, 0
    while len(acts) >= 2 and runs < most:
        for start, end in _parts(len(acts), parts):
            runs += 1
            fewer = acts[:start] + acts[end:]
            if fails(_with(script, fewer)):
                acts, parts = fewer, max(2, parts - 1)
                break
            if runs >= most:
                break
        else:
            if parts >= len(acts):
                break
            parts = min(len(acts), 2 * parts)
    return _with(script, acts)


def _parts(length: int, parts: int) -> list[tuple[int, int]]:
    size = -(-length // parts)
    return [(start, min(length, start + size)) for start in range(0, length, size)]


def _with(script: SessionScript, acts: Sequence[Act]) -> SessionScript:
    return msgspec.structs.replace(script, acts=list(acts))
