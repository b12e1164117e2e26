"""What the cabinet does with each line that it hears: the KST server without its socket.

Like the real one it has two threads of thought. The *reader* takes every line as it comes and acts at once on set
points, stops and questions for the joints. Everything else it lays into the one slot of the *main loop*, which is busy
as long as a motion or a servo lasts: what lies in the slot is lost when another line comes, or when a point-to-point
motion ends. What neither of them knows stays latched: nothing is answered any more.
"""

from __future__ import annotations

from collections.abc import Callable

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.java import numbers, reply
from pcmrs_sim.kst.main_loop import DONE, JOINTS, MainLoop, Targets
from pcmrs_sim.kst.readings import Readings

SET_POINTS: dict[str, Callable[[Readings], list[float]] | None] = {
    "jf": None,
    "jp": None,
    "jpJP": Readings.joints,
    "jpExT": Readings.external_torques,
    "jpMT": Readings.torques,
    "jpEEfP": Readings.force,
}
"""Requests that set the joints, and what they are answered with; ``jp`` with ``done``, ``jf`` not at all."""


class SimulatedCabinet:
    """One run of the cabinet's application, with one client.

    Args:
        cell: Its arm is moved.
        send: Takes what the client is told.
        close: Ends the connection.
    """

    def __init__(self, cell: CellSimulation, send: Callable[[str], None], close: Callable[[], None]) -> None:
        self._faults = cell.robot_faults
        self._targets = Targets()
        self._readings = Readings(cell.world.arm, ArmModel(cell.facts))
        self._main = MainLoop(cell, self._targets, self._readings, send)
        self._send, self._close = send, close
        self._drops, self._lost, self._latched = cell.robot_faults.drops, False, False

    def receive(self, line: str) -> None:
        """Acts on a line of the client."""
        if self._faults.cut or self._latched:
            return
        self._main.slot = ""
        try:
            self._act(line)
        except ValueError:  # ends the reader's thread in the real one
            self._latched = True

    def update(self) -> None:
        """Looks at link and arm, after time has passed."""
        self._lost = self._lost or self._faults.cut
        if self._faults.drops > self._drops or (self._lost and not self._faults.cut):
            self._close()
        self._main.update()

    def leave(self) -> None:
        """The client has gone: the arm brakes."""
        self._main.leave()

    def _act(self, line: str) -> None:
        name = line.partition("_")[0]
        if name in SET_POINTS:
            self._set_joints(name, line)
        elif name == "cArtixanPosition":
            _overwrite(self._targets.pose, numbers(line))
            self._send(DONE)
        elif line == "getJointsPositions":
            self._send(reply(self._readings.joints()))
        elif line == "stopDirectServoJoints":
            self._main.stop_servo()
            self._send(DONE)
        elif line == "end":
            self._close()
        elif self._main.knows(line):
            self._main.slot = line
            self._main.work()
        else:
            self._latched = True

    def _set_joints(self, name: str, line: str) -> None:
        _overwrite(self._targets.joints, numbers(line))
        self._main.servo()
        reading = SET_POINTS[name]
        if reading is not None:
            self._send(reply(reading(self._readings)))
        elif name == "jp":
            self._send(DONE)


def check_arm(facts: ArmFacts) -> None:
    """Accepts an arm that a Sunrise cabinet could move.

    Raises:
        ConfigurationError: It has not seven joints.
    """
    if len(facts.joints) != JOINTS:
        text = f"A KST cabinet moves an iiwa with {JOINTS} joints; {facts.name} has {len(facts.joints)}. Choose iiwa14."
        raise ConfigurationError(text, joints=len(facts.joints))


def _overwrite(array: Floats, values: list[float]) -> None:
    """Too many numbers are passed over, and too few leave the rest as it was."""
    count = min(len(values), len(array))
    array[:count] = values[:count]
