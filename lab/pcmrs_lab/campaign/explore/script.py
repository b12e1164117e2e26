"""Script of a simulated session as data: it is drawn, run, shrunk, saved and run again.

A failing script is shortened by delta debugging over its acts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from pcmrs.errors import ConfigurationError

Physics = Literal["kinematic", "mujoco"]


class Act(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One act of an operator, or one fault.

    Attributes:
        after: Pause since the act before started, or ended if it is waited for, s.
        what: ``go_on`` (do the next step of the procedure), ``stop``, ``repeat``, ``datagram``, ``wire:<command>``,
            ``<branch>.<operation>``, ``reuse:<branch>.<operation>`` (under the id of the last command),
            ``old:<command>`` (without an id, like clients that only know acknowledgements), or ``fault:<name>``.
        who: Operator; empty for faults.
        arguments: Arguments of the operation, the command or the fault.
        waits: True if the next act comes only after its verdict.
        window: Name of a window: the act is done `after` s after the next one opens; see
            `pcmrs_sim.deterministic.windows`.
        held: Least time for which that window stays open, s.
    """

    after: float
    what: str
    who: str = ""
    arguments: dict[str, Any] = {}
    waits: bool = True
    window: str = ""
    held: float = 0.0


class SessionScript(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Whole session.

    Attributes:
        seed: Seed of the network, of all simulated errors and of identifiers.
        workflow: Name of the workflow.
        physics: Physics of the simulated arm.
        coded: True if every message is packed and unpacked.
        slow: Share of the windows that take time although no act requests it.
        scene: True if a detector watches the scene.
        acts: Acts in order.
    """

    seed: int
    workflow: str = "ratms"
    physics: Physics = "kinematic"
    coded: bool = False
    slow: float = 0.0
    scene: bool = False
    acts: list[Act] = []


def read_script(path: Path) -> SessionScript:
    """Return the script of a file.

    Raises:
        ConfigurationError: The file cannot be read, or is not a script.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=SessionScript)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigurationError(f"{path} is not a script of a session: {error}.", file=str(path)) from None


def write_script(script: SessionScript, path: Path) -> None:
    """Write a script as indented JSON.

    Args:
        script: SessionScript to write.
        path: File to write.
    """
    path.write_bytes(msgspec.json.format(msgspec.json.encode(script), indent=1) + b"\n")


MOST_RUNS = 200
"""Default limit of runs for shrinking, so that it ends in reasonable time."""


def shrink(script: SessionScript, fails: Callable[[SessionScript], bool], most: int = MOST_RUNS) -> SessionScript:
    """Return the shortest script found that still fails: without any single act it passes, unless `most` was too small.

    Zeller, Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE TSE 2002, without the tests of single
    parts, which hardly ever fail by themselves here.

    Args:
        script: Script that fails.
        fails: Returns whether a script fails in the same way.
        most: Largest number of runs.
    """
    acts, parts, runs = list(script.acts), 2, 0
    while acts and runs < most:
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
