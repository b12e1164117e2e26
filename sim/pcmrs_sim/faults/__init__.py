"""Every fault that can be brought about in the simulated cell, by name; and how a line of text asks for one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from pcmrs.errors import DeviceError
from pcmrs_sim.faults import muscle, robot, scene, tracker
from pcmrs_sim.faults.fault import Fault, Faulty

FAULTS: Mapping[str, Fault] = {
    fault.name: fault for fault in (*robot.FAULTS, *tracker.FAULTS, *scene.FAULTS, *muscle.FAULTS)
}
"""By name."""

_TRUTH = {"on": True, "true": True, "off": False, "false": False}


def find_fault(name: str) -> Fault:
    """The fault of that name.

    Raises:
        DeviceError: There is none.
    """
    if name not in FAULTS:
        raise DeviceError(f"There is no fault {name!r}; `pcmrs-sim faults` lists them.", fault=name)
    return FAULTS[name]


def inject(cell: Faulty, name: str, arguments: Mapping[str, Any]) -> None:
    """Brings about a fault in a cell, or ends it.

    Raises:
        DeviceError: There is no such fault, or it cannot use these arguments.
    """
    fault = find_fault(name)
    unknown = sorted(set(arguments) - set(fault.arguments))
    if unknown:
        raise DeviceError(f"{_usage(fault)} is called with {', '.join(unknown)}, which it does not know.", fault=name)
    fault.apply(cell, arguments)


def parse_fault(line: str) -> tuple[str, dict[str, Any]]:
    """Name and arguments of a line such as ``occlude coil on``: the fault, then its arguments in their order.

    ``on`` and ``off`` become truth values and numbers become numbers; arguments at the end may be left out.

    Raises:
        DeviceError: There is no such fault, or it has fewer arguments.
    """
    name, *words = line.split()
    fault = find_fault(name)
    if len(words) > len(fault.arguments):
        raise DeviceError(f"{line.strip()!r} has {len(words)} arguments; write: {_usage(fault)}.", fault=name)
    return name, dict(zip(fault.arguments, map(_value, words), strict=False))


def _value(word: str) -> bool | float | str:
    if word in _TRUTH:
        return _TRUTH[word]
    try:
        value = float(word)
    except ValueError:
        return word
    return value if math.isfinite(value) else word


def _usage(fault: Fault) -> str:
    return " ".join((fault.name, *(f"<{argument}>" for argument in fault.arguments)))
