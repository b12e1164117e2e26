"""The KST server without its socket: the reaction to each line of the client.

Like the real one, it has two threads of control. The *reader* takes each line when it arrives. It processes set points,
targets, stops, the pins of the flange and queries of the joints at once, and puts all other lines into the single slot
of the *main loop*, which is busy during a motion or a servo session. A line in the slot is lost if another line
arrives, or if a point-to-point motion ends. An empty line, and one that neither of them knows, is skipped without a
reply; the next line is answered. Joints or a pose that are no numbers end the reader's thread: it answers nothing more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import structlog

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats
from pcmrs_sim.cell import CellSimulation
from pcmrs_sim.kst.java import numbers, reply
from pcmrs_sim.kst.main_loop import DONE, JOINTS, MainLoop, Targets
from pcmrs_sim.kst.readings import Readings

log = structlog.get_logger(__name__)

Reading = Callable[[Readings], list[float]]


@dataclass(frozen=True)
class _Values:
    """A request that sets numbers.

    Attributes:
        target: Name of the attribute of `Targets` that it sets.
        reading: Reading in its reply.
        acknowledged: Without a reading, it is answered ``done``.
        forgiving: Wrong numbers end the servo instead of the reader's thread.
    """

    target: str
    reading: Reading | None = None
    acknowledged: bool = False
    forgiving: bool = False


_READINGS: dict[str, Reading] = {
    "JP": Readings.joints,
    "ExT": Readings.external_torques,
    "MT": Readings.torques,
    "EEfP": Readings.force,
}

SET_POINTS: dict[str, _Values] = {
    "jf_": _Values("joints"),
    "jp_": _Values("joints", acknowledged=True),
    "DcSeCar_": _Values("servo_pose", forgiving=True),
    "velJDC_": _Values("velocities", acknowledged=True, forgiving=True),
    "cArtixanPosition_": _Values("pose", acknowledged=True),
    "cArtixanPositionCirc1_": _Values("circle_middle", acknowledged=True),
    "cArtixanPositionCirc2_": _Values("circle_end", acknowledged=True),
    **{f"jp{name}_": _Values("joints", reading) for name, reading in _READINGS.items()},
    **{f"DcSeCar{name}_": _Values("servo_pose", reading, forgiving=True) for name, reading in _READINGS.items()},
    **{f"velJDC{name}_": _Values("velocities", reading, forgiving=True) for name, reading in _READINGS.items()},
}
"""Requests with numbers that the reader processes."""

OUTPUTS = ("blueOn", "blueOff", *(f"pin{pin}{to}" for pin in (1, 11, 2, 12) for to in ("on", "off")))
"""Requests that set an output of the flange. There is no flange: they are answered, and nothing else happens."""
INPUTS = tuple(f"getPin{pin}" for pin in (10, 16, 13, 3, 4))
"""Requests that read an input of the flange."""
INPUT = "1\n\n"
"""Their reply, with two line feeds as the real server sends it without a flange."""


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
        self._drops, self._lost, self._reader_ended = cell.robot_faults.drops, False, False

    def receive(self, line: str) -> None:
        """Process a line of the client, without its line feed."""
        if self._faults.cut or self._reader_ended:
            return
        self._main.slot = ""  # any new line overwrites the slot, as in the real server
        name, underscore, _ = line.partition("_")
        values = SET_POINTS.get(name + underscore)
        if values is not None:
            self._set_values(values, line)
        elif line.startswith("getJointsPositions"):
            self._send(reply(self._readings.joints()))
        elif line.startswith("stopDirectServoJoints"):
            self._main.stop_servo()
            self._send(DONE)
        elif line.startswith(OUTPUTS):
            self._send(DONE)
        elif line.startswith(INPUTS):
            self._send(INPUT)
        elif line.startswith("end"):
            self._close()
        elif self._main.accepts(line):
            self._main.slot = line
            self._main.process_slot()
        elif line:
            log.warning("cabinet_skips", line=line)

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

    def _set_values(self, values: _Values, line: str) -> None:
        try:
            _overwrite(getattr(self._targets, values.target), numbers(line))
        except ValueError:
            if not values.forgiving:
                log.warning("cabinet_reader_ended", line=line)
                self._reader_ended = True
                return
            self._main.stop_servo()
        self._main.update_servo()
        if values.reading is not None:
            self._send(reply(values.reading(self._readings)))
        elif values.acknowledged:
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
