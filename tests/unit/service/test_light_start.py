"""Processes of a cell load nothing that takes longer to load than they take to start."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("scipy", "trimesh", "networkx", "matplotlib", "pandas")
SHIPPED = """
from pcmrs.workflows.settings import BodySettings
from pcmrs.formats.mesh import read_mesh
from pcmrs.kinematics.collision import hull
from pcmrs.workflows.surface import find_surface
for surface in ("head_phantom.ply", "femur_phantom.ply"):
    hull(read_mesh(find_surface(BodySettings(surface=surface)), "m", "RAS").vertices)
"""


@pytest.mark.parametrize(
    "loaded",
    [
        f"import pcmrs.service._daemon\n{SHIPPED}",
        f"import pcmrs.workflows.planning_process\n{SHIPPED}",
        "import pcmrs.node",
        "import pcmrs.recording.writer",
        "import pcmrs_sim.process.world",
    ],
    ids=["daemon", "planner", "node", "recorder", "world"],
)
def test_nothing_heavy_is_loaded_at_the_start(loaded: str) -> None:
    code = f"import sys\n{loaded}\nprint([name for name in {HEAVY} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
