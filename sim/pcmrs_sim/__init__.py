"""A cell in software: MuJoCo arm, tracker, pointer and phantom behind the device protocols.

Raises:
    ImportError: MuJoCo is not installed; the base install leaves it out.
"""

from importlib.util import find_spec

if find_spec("mujoco") is None:
    raise ImportError("the simulated cell needs MuJoCo, which the extra pcmrs[sim] installs.")
