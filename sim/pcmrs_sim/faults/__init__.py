"""All faults that can be injected into the simulated cell, by name, and lines of text that name them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pcmrs.errors import DeviceError
from pcmrs_sim.faults import muscle, robot, scene, tracker
from pcmrs_sim.faults.fault import Fault, FaultTarget

FAULTS: Mapping[str, Fault] = {
    fault.name: fault for fault in (*robot.FAULTS, *tracker.FAULTS, *scene.FAULTS, *muscle.FAULTS)
}
"""Name to fault."""

_SWITCH_WORDS = {"on": True, "true": True, "off": False, "false": False}


def find_fault(name: str) -> Fault:
    """Return the fault of a name.

    Raises:
        DeviceError: No fault has this name.
    """
    if name not in FAULTS:
        raise DeviceError(f"There is no fault {name!r}; `pcmrs-sim faults` lists them.", fault=name)
    return FAULTS[name]


def inject(cell: FaultTarget, name: str, arguments: Mapping[str, Any]) -> None:
    """Inject a fault into a cell, or end it.

    Args:
        cell: The running cell.
        name: Name of the fault.
        arguments: Arguments of the fault by name. Which values end it depends on the fault.

    Raises:
        DeviceError: No fault has this name, or an argument is missing, unknown or out of range.
    """
    fault = find_fault(name)
    unknown = sorted(set(arguments) - set(fault.arguments))
    if unknown:
        text = f"The fault {name} has no argument {', '.join(unknown)}; write: {_usage(fault)}."
        raise DeviceError(text, fault=name)
    fault.apply(cell, arguments)


def parse_fault(line: str) -> tuple[str, dict[str, Any]]:
    """Return name and arguments of a line such as ``occlude coil on``: the fault, then its arguments in order.

    ``on`` and ``off`` become truth values and numbers become numbers. Arguments at the end may be left out.

    Args:
        line: The line. It must hold at least one word.

    Raises:
        DeviceError: No fault has this name, or the line holds too many arguments.
    """
    name, *words = line.split()
    fault = find_fault(name)
    if len(words) > len(fault.arguments):
        raise DeviceError(f"{line.strip()!r} has {len(words)} arguments; write: {_usage(fault)}.", fault=name)
    return name, dict(zip(fault.arguments, map(_value, words), strict=False))


def _value(word: str) -> bool | float | str:
    if word in _SWITCH_WORDS:
        return _SWITCH_WORDS[word]
    try:
        value = float(word)
    except ValueError:
        return word
    return value if math.isfinite(value) else word


def _usage(fault: Fault) -> str:
    return " ".join((fault.name, *(f"<{argument}>" for argument in fault.arguments)))
