"""The command line `pcmrs`; the module of each command is loaded when it is used."""

from __future__ import annotations

import io
import os
import sys
from typing import Final

import click

import pcmrs.lean_structlog  # noqa: F401
from pcmrs.cli.lazy import LABORATORY, LazyGroup
from pcmrs.files import keep_private

COMMANDS = {
    "call": "pcmrs.cli.cell:call",
    "state": "pcmrs.cli.cell:state",
    "watch": "pcmrs.cli.cell:watch",
    "keys": "pcmrs.cli.cell:keys",
    "lease": "pcmrs.cli.lease:lease",
    "cells": "pcmrs.cli.cells:cells",
    "console": "pcmrs.cli.console:console",
    "health": "pcmrs.cli.health:health",
    "doctor": "pcmrs.cli.doctor:doctor",
    "stop": "pcmrs.cli.cell:stop",
    "journal": "pcmrs.cli.journal:journal",
    "archive": "pcmrs.cli.archive:archive",
    "fsm": "pcmrs.cli.fsm:fsm",
    "faults": LABORATORY,
    "placements": "pcmrs.cli.placements:placements",
    "register": "pcmrs.cli.register:register",
    "skin": "pcmrs.cli.skin:skin",
    "calibrate": "pcmrs.cli.calibrate:calibrate",
    "experiment": LABORATORY,
    "demo": LABORATORY,
    "teleop": "pcmrs.cli.teleop:teleop",
    "session": LABORATORY,
    "pki": "pcmrs.cli.pki:pki",
    "peers": "pcmrs.cli.peers:peers",
    "node": "pcmrs.cli.serve:node",
    "serve": "pcmrs.cli.serve:serve",
    "router": "pcmrs.cli.router:router",
    "record": "pcmrs.cli.recording:record",
    "ros2": "pcmrs.cli.ros2:ros2",
    "repair": "pcmrs.cli.recording:repair",
    "play": "pcmrs.cli.playback:play",
    "export-session": "pcmrs.cli.export_session:export_session",
    "report": "pcmrs.cli.report:report",
}

SHARED: Final = ("fsm", "pki")
"""Commands whose files others may read: workflows and certificates. All others may write data of a session."""


@click.group(cls=LazyGroup, commands=COMMANDS, prefix="", context_settings={"help_option_names": ["-h", "--help"]})
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
