"""Hierarchical finite state machines: blueprints, branches, and the closure of a command."""

from pcmrs.fsm._branch import StateSet, flags_of
from pcmrs.fsm._state import State
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.closure import Change, Closure, Denial, Effect, close
from pcmrs.fsm.engine import Engine
from pcmrs.fsm.files.load import BlueprintExamination, examine, load_blueprint, parse_blueprint
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify.guide import Guidance, Guide, guide_for

__all__ = [
    "START_OUTCOME",
    "Blueprint",
    "BlueprintExamination",
    "BranchSpec",
    "Change",
    "Closure",
    "Denial",
    "Effect",
    "Engine",
    "Finding",
    "Guidance",
    "Guide",
    "OperationSpec",
    "State",
    "StateSet",
    "close",
    "examine",
    "flags_of",
    "guide_for",
    "load_blueprint",
    "parse_blueprint",
]
