"""Lines on the standard input of `pcmrs-sim`, and their effect on a simulated cell.

python -m fuzz.faults -max_total_time=60
"""

from __future__ import annotations

import math
from contextlib import suppress

from fuzz.running import instrumented, run

with instrumented("pcmrs_sim"):
    from pcmrs.clock import SystemClock
    from pcmrs.devices.motion.force import ForceSettings
    from pcmrs.errors import PcmrsError
    from pcmrs.kinematics.arms import ARMS
    from pcmrs_sim.cell import CellSimulation
    from pcmrs_sim.faults import FAULTS, inject, parse_fault
    from pcmrs_sim.settings import SimSettings

CELL = CellSimulation(SimSettings(), ARMS["iiwa14"], ForceSettings(force_limit=math.inf), SystemClock())
NAMES = sorted(FAULTS)


async def one(data: bytes) -> None:
    """Inject a fault; the first byte may select it, so that arguments are tried, too."""
    text = data[1:].decode("utf-8", "replace")
    line = f"{NAMES[data[0] % len(NAMES)]} {text}" if data[:1] > b"\x20" else text
    if not line.strip():
        return
    with suppress(PcmrsError):
        inject(CELL, *parse_fault(line))


if __name__ == "__main__":
    run(one)
