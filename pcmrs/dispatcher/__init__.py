"""Dispatcher-State/Flag/Operation: commands in, decisions out, operations performed in between."""

from pcmrs.dispatcher.dispatcher import Dispatcher
from pcmrs.dispatcher.events import DispatcherListener, Recorder
from pcmrs.dispatcher.procedure import Procedure
from pcmrs.dispatcher.workflow import Activity, NoArguments, ProcedureData, Registry, Run, Workflow

__all__ = [
    "Activity",
    "Dispatcher",
    "DispatcherListener",
    "NoArguments",
    "Procedure",
    "ProcedureData",
    "Recorder",
    "Registry",
    "Run",
    "Workflow",
]
