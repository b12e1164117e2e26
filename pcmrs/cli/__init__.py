"""The command line `pcmrs`; the module of each command is loaded when it is used."""

from __future__ import annotations

import io
import os
import sys
from typing import Final

import click

from pcmrs.cli.lazy import LABORATORY, LazyCommand, LazyGroup
from pcmrs.files import keep_private

COMMANDS = {
    "call": LazyCommand("pcmrs.cli.cell:call", "Ask for an operation and print the verdict."),
    "next": LazyCommand(
        "pcmrs.cli.cell:next_",
        "Print the next step of the procedure, or the next step towards an operation, and why.",
    ),
    "operations": LazyCommand(
        "pcmrs.cli.operations:operations", "List the operations with their arguments, and whether they are allowed now."
    ),
    "state": LazyCommand(
        "pcmrs.cli.cell:state", "Print the state of all branches, the flags, running operations, and unknown outcomes."
    ),
    "watch": LazyCommand(
        "pcmrs.cli.cell:watch", "Print states, decisions and device events as they happen, until interrupted."
    ),
    "keys": LazyCommand("pcmrs.cli.cell:keys", "List the keys to publish and subscribe to, with their payloads."),
    "lease": LazyCommand(
        "pcmrs.cli.lease:lease",
        "Hold a cell: one operator or teleoperator at a time gives commands, and planners may plan for them.",
    ),
    "cells": LazyCommand(
        "pcmrs.cli.cells:cells", "List the connected cells in which you have a role; on a router, those of all sites."
    ),
    "console": LazyCommand(
        "pcmrs.cli.console:console",
        "Serve the page that shows a cell: workflow, scene, planning, signals and session.",
    ),
    "health": LazyCommand(
        "pcmrs.cli.health:health", "Print the health of the daemon, the reasons for problems, and what to do."
    ),
    "doctor": LazyCommand(
        "pcmrs.cli.doctor:doctor",
        "Check that this machine has what the configured cell needs, without changing anything.",
    ),
    "stop": LazyCommand(
        "pcmrs.cli.cell:stop",
        "Stop every motion and latch: nothing moves until the stop is acknowledged, in RATMS by robot.acknowledge.",
    ),
    "journal": LazyCommand(
        "pcmrs.cli.journal:journal",
        "Print the recorded commands, decisions and reports, and prove that the journal is whole.",
    ),
    "archive": LazyCommand(
        "pcmrs.cli.archive:archive",
        "Copy the journals of many cells to one place, verify it, and answer questions about all of them.",
    ),
    "backup": LazyCommand(
        "pcmrs.cli.backup:backup",
        "Copy the configured cell into the new folder TARGET, and verify the copy.",
    ),
    "restore": LazyCommand("pcmrs.cli.backup:restore", "Make a cell's folder FOLDER from BACKUP."),
    "upgrade": LazyCommand(
        "pcmrs.cli.upgrade:upgrade",
        "Bring FOLDER, a cell's folder that an earlier version wrote, to the formats of this version.",
    ),
    "fsm": LazyCommand("pcmrs.cli.fsm:fsm", "Design, draft, verify, draw, import, test and compare workflows."),
    "faults": LazyCommand(
        LABORATORY, "Inject faults into simulated cells, and check that nothing is lost and nothing moves by itself."
    ),
    "placements": LazyCommand(
        "pcmrs.cli.placements:placements", "Print the errors of recorded placements: measured against planned pose."
    ),
    "register": LazyCommand(
        "pcmrs.cli.register:register",
        "Register the landmarks in DIGITIZED (body_ref) to those in PLAN (image), and check the result.",
    ),
    "coverage": LazyCommand(
        "pcmrs.cli.coverage:coverage",
        "Print how many points of the surface were touched where, and where more of them would lower the TRE most.",
    ),
    "skin": LazyCommand(
        "pcmrs.cli.skin:skin",
        "Extract the outer surface of the body in VOLUME: a NIfTI file, or a folder with one DICOM series.",
    ),
    "calibrate": LazyCommand(
        "pcmrs.cli.calibrate:calibrate",
        "Calibrate the pointer or the tool from poses in a file, or with --live on a running cell.",
    ),
    "experiment": LazyCommand(LABORATORY, "Repeat the paper's experiments on the simulated cell."),
    "demo": LazyCommand(
        LABORATORY, "Run a whole procedure on the simulated cell: plan, digitize, register, and 12 placements."
    ),
    "teleop": LazyCommand(
        "pcmrs.cli.teleop:teleop", "Guide the tool near its planned pose, for as long as the clutch is held."
    ),
    "session": LazyCommand(LABORATORY, "Run whole sessions on the simulated cell."),
    "pki": LazyCommand(
        "pcmrs.cli.pki:pki",
        "Manage the certificates of a lab: its own authority, and one identity for each person and process.",
    ),
    "peers": LazyCommand(
        "pcmrs.cli.peers:peers", "Give clients on other machines a key, so that the gateway accepts their commands."
    ),
    "node": LazyCommand("pcmrs.cli.serve:node", hidden=True),
    "serve": LazyCommand(
        "pcmrs.cli.serve:serve", "Run the daemon of one cell: by default robotic TMS on the simulated cell."
    ),
    "router": LazyCommand(
        "pcmrs.cli.router:router", "Forward the messages of cells and people, as far as the register allows them."
    ),
    "record": LazyCommand(
        "pcmrs.cli.recording:record", "Record all messages of a running cell on its bus, until Ctrl-C."
    ),
    "scene": LazyCommand(
        "pcmrs.cli.scene:scene", "Watch the zones of a running cell with a depth camera, and report what enters them."
    ),
    "ros2": LazyCommand(
        "pcmrs.cli.ros2:ros2",
        "Publish joints, frames, poses and the state of a running cell for ROS 2, until Ctrl-C.",
    ),
    "repair": LazyCommand(
        "pcmrs.cli.recording:repair",
        "Save the readable part of a damaged recording, up to its last whole chunk, and report how much is lost.",
    ),
    "play": LazyCommand(
        "pcmrs.cli.playback:play", "Publish recordings on the bus again, byte for byte, under pcmrs/replay/NAME."
    ),
    "export-session": LazyCommand(
        "pcmrs.cli.export_session:export_session",
        "Copy a session of the configured cell into one folder, and verify the copy of its journal.",
    ),
    "data": LazyCommand("pcmrs.cli.data:data", "Export the data of a procedure for other software."),
    "report": LazyCommand(
        "pcmrs.cli.report:report", "Write the report of a session: one page for a clinician, then all details."
    ),
}
"""Commands with the first sentences of their help texts, which are also in their modules."""

SECTIONS = {
    "Run a cell": ("serve", "console", "router", "ros2", "scene", "doctor"),
    "Command and watch it": (
        "call",
        "next",
        "operations",
        "state",
        "watch",
        "stop",
        "lease",
        "teleop",
        "keys",
        "cells",
        "health",
    ),
    "Keep a cell": ("backup", "restore", "upgrade"),
    "Prepare a procedure": ("calibrate", "skin", "register", "coverage", "fsm", "pki", "peers"),
    "Records and results": (
        "journal",
        "record",
        "play",
        "repair",
        "placements",
        "report",
        "export-session",
        "archive",
        "data",
    ),
    "Try and test in simulation": ("demo", "session", "experiment", "faults"),
}
"""Headings of the help, and the commands below them."""

SHARED: Final = ("fsm", "pki")
"""Commands whose files others may read: workflows and certificates. All others may write data of a session."""


@click.group(
    cls=LazyGroup,
    commands=COMMANDS,
    prefix="",
    sections=SECTIONS,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(package_name="pcmrs")
@click.pass_context
def main(context: click.Context) -> None:
    """PCMRS: medical robot procedures as hierarchical state machines.

    Start a cell with pcmrs-serve. These commands control it, and design and check its workflow. Research
    software, not a medical device.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without ° shows a ? instead of a traceback
    if context.invoked_subcommand not in SHARED:
        before = keep_private()
        context.call_on_close(lambda: os.umask(before))
