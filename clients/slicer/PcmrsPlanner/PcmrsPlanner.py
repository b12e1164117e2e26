"""PCMRS Planner: plans, registers and places over the string protocol, and shows tool, body and states.

All that is not Slicer's is in `pcmrs_link`, which is tested against the daemon; this file was not run in Slicer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import ctk
import qt
import slicer
import vtk
from pcmrs_link import (
    BusyError,
    Feed,
    Link,
    LinkError,
    MessageError,
    Planner,
    Pose,
    PoseError,
    Signer,
    panel,
    pose_of_line,
    pose_of_matrix,
    read_key,
)
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleWidget,
)

TICK_MS = 15
"""Period of the timer that drains the sockets."""
TICKS_PER_REFRESH = 10
"""Number of ticks between two updates of the texts; poses go into the scene at every tick."""

ROWS = (
    ("Connect robot", "Disconnect robot"),
    ("Digitize all", "Register", "Previous registration"),
    ("Approach", "Confirm"),
    ("Back off", "Home"),
    ("Show tool", "Hide tool"),
    ("Show tip", "Hide tip"),
    ("Restart procedure",),
)
"""Buttons of one command each."""


class PcmrsPlanner(ScriptedLoadableModule):
    """The module as Slicer lists it."""

    def __init__(self, parent: Any) -> None:
        ScriptedLoadableModule.__init__(self, parent)
        self.parent.title = "PCMRS Planner"
        self.parent.categories = ["IGT"]
        self.parent.dependencies = []
        self.parent.contributors = ["PCMRS"]
        self.parent.helpText = "Plans, registers and places over a PCMRS daemon. Research software, no medical device."
        self.parent.acknowledgementText = ""


class PcmrsPlannerLogic(ScriptedLoadableModuleLogic):
    """The connection, and what of it goes into the scene.

    Attributes:
        planner: None while not connected.
        feed: None while not connected, or without OpenIGTLink.
    """

    def __init__(self) -> None:
        ScriptedLoadableModuleLogic.__init__(self)
        self.planner: Planner | None = None
        self.feed: Feed | None = None
        self._shown: dict[str, float] = {}

    def connect(self, host: str, port: int, feed_port: int, peer: str, key_file: str, *, answers_signed: bool) -> None:
        """Open the sockets, and request the joints.

        Args:
            host: The daemon's.
            port: Of its planner link.
            feed_port: Of its OpenIGTLink; 0 does without.
            peer: Name to sign with; "" signs nothing.
            key_file: The peer's key.
            answers_signed: Whether answers without a signature are dropped.

        Raises:
            OSError: A port is in use, the host is not known, or the key cannot be read.
            ValueError: The key file holds no key, or the name is none that can sign.
        """
        signer = Signer(peer, read_key(key_file), answers_signed=answers_signed) if peer else None
        self.planner = Planner(Link(host, port, signer=signer))
        self.feed = Feed(host, feed_port) if feed_port else None
        self.planner.hello()

    def disconnect(self) -> None:
        """Close the sockets; the daemon continues."""
        if self.planner is not None:
            self.planner.link.close()
        if self.feed is not None:
            self.feed.close()
        self.planner = self.feed = None

    def tick(self) -> None:
        """Drain the sockets and put new poses into the scene."""
        if self.planner is None:
            return
        self.planner.link.tick()
        if self.feed is not None:
            self.feed.tick()
        for name, shown in panel.poses(self.planner.link, self.feed).items():
            if self._shown.get(name) != shown.at:
                self._shown[name] = shown.at
                _show(name, shown.pose)


class PcmrsPlannerWidget(ScriptedLoadableModuleWidget):
    """The panel."""

    def setup(self) -> None:
        """Build the panel and start the timer."""
        ScriptedLoadableModuleWidget.setup(self)
        self.logic = PcmrsPlannerLogic()
        self._jobs: list[Any] = []
        self._ticks = 0
        self._add_stop()
        self._add_connection()
        self._add_plans()
        self._add_actions()
        self._add_state()
        self.layout.addStretch(1)
        self._timer = qt.QTimer()
        self._timer.setTimerType(qt.Qt.PreciseTimer)
        self._timer.setInterval(TICK_MS)
        self._timer.connect("timeout()", self._tick)
        self._timer.start()

    def cleanup(self) -> None:
        """End the link; Slicer calls this when the module is unloaded."""
        self._timer.stop()
        self.logic.disconnect()

    def _add_stop(self) -> None:
        stop = qt.QPushButton("STOP")
        stop.setMinimumHeight(80)
        stop.setStyleSheet("background-color: #c00000; color: white; font-size: 32px; font-weight: bold;")
        stop.setToolTip("Stops the robot at once, also in a motion. It is no emergency stop.")
        stop.connect("clicked(bool)", lambda _: self._stop())
        self._status = qt.QLabel("Not connected")
        self._status.setWordWrap(True)
        self.layout.addWidget(stop)
        self.layout.addWidget(self._status)

    def _add_connection(self) -> None:
        form = self._section("Connection")
        self._host = qt.QLineEdit("127.0.0.1")
        self._port = _spin(1, 65535, 8057)
        self._feed_port = _spin(0, 65535, 0)
        self._feed_port.setToolTip("Port of gateway.openigtlink, such as 18944; 0 does without, and shows less.")
        self._peer = qt.QLineEdit()
        self._peer.setToolTip("Name of this client in gateway.peers; empty sends unsigned.")
        self._key_file = ctk.ctkPathLineEdit()
        self._key_file.filters = ctk.ctkPathLineEdit.Files
        self._answers_signed = qt.QCheckBox()
        self._answers_signed.setToolTip('Drops answers that are not signed: for a peer with counter = "unix_ns".')
        self._connect = qt.QPushButton("Connect")
        self._connect.connect("clicked(bool)", lambda _: self._toggle())
        form.addRow("Host", self._host)
        form.addRow("Port", self._port)
        form.addRow("OpenIGTLink port", self._feed_port)
        form.addRow("Signs as", self._peer)
        form.addRow("Key file", self._key_file)
        form.addRow("Answers are signed", self._answers_signed)
        form.addRow(self._connect)

    def _add_plans(self) -> None:
        form = self._section("Plan")
        self._landmarks = _node_selector("vtkMRMLMarkupsFiducialNode")
        self._tool = _node_selector("vtkMRMLLinearTransformNode", "vtkMRMLMarkupsLineNode")
        self._tool.setToolTip("A transform: +z away from the body. A line: from the target away from the body.")
        self._turn = qt.QDoubleSpinBox()
        self._turn.setRange(-180.0, 180.0)
        self._turn.setToolTip("Of a line, about its axis, degrees; at 0 the tool's +y is anterior.")
        self._index = _spin(0, 99, 0)
        form.addRow("Landmarks", self._landmarks)
        form.addRow(self._job("Plan landmarks", self._plan_landmarks))
        form.addRow("Tool at the target", self._tool)
        form.addRow("Turn of a line", self._turn)
        form.addRow(self._job("Plan tool", self._plan_tool))
        form.addRow(self._job("Plan tool from mixed reality", self._plan_relayed_tool))
        form.addRow("Landmark, from 0", self._index)
        form.addRow(self._job("Digitize this one", lambda planner: planner.digitize(self._index.value)))

    def _add_actions(self) -> None:
        form = self._section("Procedure")
        for titles in ROWS:
            row = qt.QHBoxLayout()
            for title in titles:
                row.addWidget(self._job(title, partial(Planner.act, title=title)))
            form.addRow(row)
        self._offset = [qt.QDoubleSpinBox() for _ in range(3)]
        row = qt.QHBoxLayout()
        for box in self._offset:
            box.setRange(-10.0, 10.0)
            row.addWidget(box)
        row.addWidget(self._job("Nudge", lambda planner: planner.nudge([box.value for box in self._offset])))
        form.addRow("x y z of the tool, mm", row)

    def _add_state(self) -> None:
        form = self._section("State")
        self._state, self._placed, self._refusals = qt.QLabel(), qt.QLabel(), qt.QPlainTextEdit()
        self._refusals.setReadOnly(True)
        form.addRow(self._state)
        form.addRow(self._placed)
        form.addRow("Not accepted", self._refusals)

    def _section(self, title: str) -> Any:
        section = ctk.ctkCollapsibleButton()
        section.text = title
        self.layout.addWidget(section)
        return qt.QFormLayout(section)

    def _job(self, title: str, begin: Callable[[Planner], None]) -> Any:
        """A button that begins a job; it can be pressed while none is running."""
        button = qt.QPushButton(title)
        button.enabled = False
        button.connect("clicked(bool)", lambda _: self._begin(begin))
        self._jobs.append(button)
        return button

    def _begin(self, begin: Callable[[Planner], None]) -> None:
        if self.logic.planner is None:
            return
        try:
            begin(self.logic.planner)
        except (BusyError, MessageError, PoseError) as error:
            slicer.util.errorDisplay(str(error))
        self._refresh()

    def _stop(self) -> None:
        if self.logic.planner is None:
            self._status.text = "NOT CONNECTED: Stop was not sent; use the emergency stop"
            return
        self.logic.planner.stop()
        self._refresh()

    def _toggle(self) -> None:
        if self.logic.planner is not None:
            self.logic.disconnect()
        else:
            try:
                self.logic.connect(
                    self._host.text.strip(),
                    self._port.value,
                    self._feed_port.value,
                    self._peer.text.strip(),
                    self._key_file.currentPath,
                    answers_signed=self._answers_signed.checked,
                )
            except (LinkError, OSError, ValueError) as error:
                slicer.util.errorDisplay(str(error))
        self._refresh()

    def _plan_landmarks(self, planner: Planner) -> None:
        node = self._landmarks.currentNode()
        if node is None:
            raise PoseError("Choose a point list.")
        planner.plan_landmarks(_points(node))

    def _plan_tool(self, planner: Planner) -> None:
        node = self._tool.currentNode()
        if node is None:
            raise PoseError("Choose a transform or a line.")
        planner.plan_tool(self._pose(node))

    def _plan_relayed_tool(self, planner: Planner) -> None:
        planner.plan_tool(planner.relayed_tool(math.radians(self._turn.value)))

    def _pose(self, node: Any) -> Pose:
        if not node.IsA("vtkMRMLMarkupsLineNode"):
            matrix = vtk.vtkMatrix4x4()
            node.GetMatrixTransformToWorld(matrix)
            return pose_of_matrix([[matrix.GetElement(row, column) for column in range(4)] for row in range(4)])
        ends = _points(node)
        if len(ends) != 2:
            raise PoseError("The line needs its two points: the target, and one away from the body.")
        return pose_of_line(ends[0], ends[1], math.radians(self._turn.value))

    def _tick(self) -> None:
        self.logic.tick()
        self._ticks += 1
        if self._ticks % TICKS_PER_REFRESH == 0:
            self._refresh()

    def _refresh(self) -> None:
        planner, feed = self.logic.planner, self.logic.feed
        self._connect.text = "Connect" if planner is None else "Disconnect"
        for button in self._jobs:
            button.enabled = planner is not None and planner.link.under_way is None
        if planner is None:
            return
        self._status.text = panel.status(planner, feed)
        rows = panel.branch_rows(planner, feed) + panel.pose_rows(planner.link, feed)
        if feed is not None and feed.problem is not None:
            rows.append(("OpenIGTLink", feed.problem, ""))
        self._state.text = "\n".join("   ".join(row) for row in rows)
        self._placed.text = "\n".join(panel.results(planner))
        text = "\n".join(f"{_clock(each.at)} {each.title}: {each.text}" for each in reversed(planner.refusals))
        if text != self._refusals.plainText:
            self._refusals.plainText = text


def _points(node: Any) -> list[list[float]]:
    """Points of markups that are placed, in the world: RAS, mm."""
    points = []
    for index in range(node.GetNumberOfControlPoints()):
        if node.GetNthControlPointPositionStatus(index) == slicer.vtkMRMLMarkupsNode.PositionDefined:
            point = [0.0, 0.0, 0.0]
            node.GetNthControlPointPositionWorld(index, point)
            points.append(point)
    return points


def _show(name: str, pose: Pose) -> None:
    """Put a pose into the linear transform of that name, which is made if the scene has none."""
    node = slicer.mrmlScene.GetFirstNode(name, "vtkMRMLLinearTransformNode")
    if node is None:
        node = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", name)
    matrix = vtk.vtkMatrix4x4()
    for row, values in enumerate(pose.matrix):
        for column, value in enumerate(values):
            matrix.SetElement(row, column, value)
    node.SetMatrixTransformToParent(matrix)


def _node_selector(*types: str) -> Any:
    selector = slicer.qMRMLNodeComboBox()
    selector.nodeTypes = list(types)
    selector.noneEnabled = True
    selector.addEnabled = False
    selector.removeEnabled = False
    selector.setMRMLScene(slicer.mrmlScene)
    return selector


def _spin(least: int, most: int, value: int) -> Any:
    box = qt.QSpinBox()
    box.setRange(least, most)
    box.value = value
    return box


def _clock(wall: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(wall))
