"""The KST server without its socket: the reaction to each line of the client.

Like the real one, it has two threads of control. The *reader* takes each line when it arrives. It processes set points,
stops and queries of the joints at once, and puts all other lines into the single slot of the *main loop*, which is busy
during a motion or a servo session. A line in the slot is lost if another line arrives, or if a point-to-point motion
ends. A line that neither of them knows latches the server: it answers nothing more.
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
"""Requests that set the joints, each with the reading in its reply. ``jp`` is answered ``done``, and ``jf`` is not."""


class SimulatedCabinet:
    """One run of the cabinet's application, with one client.

    Args:
        cell: The running cell, whose arm it moves.
        send: Called with each reply to the client.
        close: Closes the connection.
    """

    def __init__(self, cell: CellSimulation, send: Callable[[str], None], close: Callable[[], None]) -> None:
        self._faults = cell.robot_faults
        self._targets = Targets()
        self._readings = Readings(cell.world.arm, ArmModel(cell.facts))
        self._main = MainLoop(cell, self._targets, self._readings, send)
        self._send, self._close = send, close
        self._drops, self._lost, self._latched = cell.robot_faults.drops, False, False

    def receive(self, line: str) -> None:
        """Process a line of the client, without its line feed."""
        if self._faults.cut or self._latched:
            return
        self._main.slot = ""  # any new line overwrites the slot, as in the real server
        try:
            self._dispatch(line)
        except ValueError:  # in the real server, this ends the reader's thread
            self._latched = True

    def update(self) -> None:
        """Check link and arm after time has passed."""
        # A TCP connection does not notice that its link is cut. It fails when the link is restored.
        self._lost = self._lost or self._faults.cut
        if self._faults.drops > self._drops or (self._lost and not self._faults.cut):
            self._close()
        self._main.update()

    def leave(self) -> None:
        """Brake the arm because the client has gone."""
        self._main.leave()

    def _dispatch(self, line: str) -> None:
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
        elif self._main.accepts(line):
            self._main.slot = line
            self._main.process_slot()
        else:
            self._latched = True

    def _set_joints(self, name: str, line: str) -> None:
        _overwrite(self._targets.joints, numbers(line))
        self._main.update_servo()
        reading = SET_POINTS[name]
        if reading is not None:
            self._send(reply(reading(self._readings)))
        elif name == "jp":
            self._send(DONE)


def check_arm(facts: ArmFacts) -> None:
    """Check that a Sunrise cabinet could move an arm.

    Raises:
        ConfigurationError: The arm does not have seven joints.
    """
    if len(facts.joints) != JOINTS:
        text = f"A KST cabinet moves an iiwa with {JOINTS} joints; {facts.name} has {len(facts.joints)}. Choose iiwa14."
        raise ConfigurationError(text, joints=len(facts.joints))


def _overwrite(array: Floats, values: list[float]) -> None:
    """Write values into an array. Surplus values are ignored; with too few, the rest of the array stays as it was."""
    count = min(len(values), len(array))
    array[:count] = values[:count]
