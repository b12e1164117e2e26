"""The process of a simulated world ends with the link to its node, and by no signal that ends the node."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence

import pytest

from tests import ROOT

pytest.importorskip("mujoco")

WITHIN = 60.0
SIGNALLED = """
import os, signal
from pcmrs_sim.process import world

def serve(work):
    work.close()
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(os.getpid(), number)
    print("serves", os.environ["MUJOCO_GL"], flush=True)

world.run = serve
world.main()
print("ended", flush=True)
"""


def start(words: Sequence[str], variables: Mapping[str, str], stdin: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
    path = os.pathsep.join(filter(None, (str(ROOT), str(ROOT / "sim"), os.environ.get("PYTHONPATH"))))
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    environment |= {"PYTHONPATH": path, **variables}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, *words], stdin=stdin, stdout=pipe, stderr=pipe, env=environment, text=True)


def test_a_world_ends_with_its_link() -> None:
    node, link = socket.socketpair()
    with link:
        world = start(("-m", "pcmrs_sim.process.world"), {}, link.fileno())
    node.close()
    assert (*world.communicate(timeout=WITHIN), world.returncode) == ("", "", 0)


@pytest.mark.parametrize(("variables", "window"), [({}, "disable"), ({"MUJOCO_GL": "egl"}, "egl")])
def test_a_world_outlives_the_signals_that_end_its_node(variables: dict[str, str], window: str) -> None:
    """The node holds the arm before it ends, which needs the world. Who draws the world chooses how."""
    world = start(("-c", SIGNALLED), variables)
    assert (*world.communicate(timeout=WITHIN), world.returncode) == (f"serves {window}\nended\n", "", 0)
