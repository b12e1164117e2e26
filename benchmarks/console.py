"""Frames that the console's scene shows per second while the arm moves, in headless Chromium.

A cell in real time with a kinematic arm, the console and the browser are processes of one machine. Chromium draws
and composes with the processor, without a graphics card, and only takes processor time that is free (`chrt -i 0`).
While the tool moves to its standoff and home, the benchmark counts the frames that the browser has drawn, and those of
them in which the arm has moved. The aim is 30 of the latter per second. Everything is simulated.

    .venv/bin/python benchmarks/console.py [--motions 4] [--json]
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from pcmrs.client import PlainClient

sys.path.append(str(Path(__file__).parents[1]))
from tests.system.console.consoles import ask, browser, client_of, console, running_cell, to_registered_head

AIM_HZ = 30.0
SETTINGS = ("cell.rate=1", "procedure.max_pose_age=3", "robot.deadman=1.0", "sim.arm.physics=kinematic")
COUNT = """() => {
    const scene = window[Object.keys(window).find((name) => name.startsWith("scene_c"))];
    const links = () => scene.children.filter((each) => each.name === "link");
    window.counted = { drawn: [], moved: [] };
    let before = "";
    scene.onBeforeRender = () => {
        const now = performance.now();
        const stand = links().map((each) => [...each.position.toArray(), ...each.quaternion.toArray()].join()).join();
        window.counted.drawn.push(now);
        if (stand !== before) window.counted.moved.push(now);
        before = stand;
    };
}"""


def measure(motions: int) -> list[dict[str, float]]:
    """Return the frame rates of some motions."""
    with (
        tempfile.TemporaryDirectory(prefix="pcmrs-") as name,
        running_cell(Path(name), *SETTINGS) as address,
        console(*address) as (_, url),
        browser(url) as page,
        client_of(address) as cell,
    ):
        page.locator("canvas").first.wait_for()
        to_registered_head(cell)
        return [
            during(page, cell, operation)
            for _ in range(motions)
            for operation in ("placement.approach", "placement.home")
        ]


def during(page: Any, cell: PlainClient, operation: str) -> dict[str, float]:
    """Return the frame rates from the first frame in which the arm has moved to the last one.

    Args:
        page: Page of the console in the browser.
        cell: Client of the cell.
        operation: Motion, ``branch.operation``.
    """
    page.evaluate(COUNT)
    ask(cell, operation)
    counted = page.evaluate("() => window.counted")
    moved = np.array(counted["moved"][1:]) / 1e3
    drawn = np.array(counted["drawn"]) / 1e3
    lasted = moved[-1] - moved[0]
    return {
        "lasted_s": float(lasted),
        "drawn_hz": float(((drawn >= moved[0]) & (drawn <= moved[-1])).sum() / lasted),
        "moved_hz": float((len(moved) - 1) / lasted),
        "longest_ms": float(np.diff(moved).max() * 1e3),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--motions", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    report = measure(given.motions)
    if given.json:
        print(json.dumps(report))
        return
    print(f"Python {platform.python_version()}; the aim is {AIM_HZ:g} frames/s in which the arm has moved")
    for row in report:
        print("  ".join(f"{what} {value:7.2f}" for what, value in row.items()))


if __name__ == "__main__":
    main()
