"""Hierarchical finite state machines: blueprints, branches, and the closure of a command."""

from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.branch import State, StateSet, flags_of
from pcmrs.fsm.closure import Change, Closure, Denial, Effect, close
from pcmrs.fsm.explore import explore
from pcmrs.fsm.load import load_blueprint, parse_blueprint

__all__ = [
    "START_OUTCOME",
    "Blueprint",
    "BranchSpec",
    "Change",
    "Closure",
    "Denial",
    "Effect",
    "OperationSpec",
    "State",
    "StateSet",
    "close",
    "explore",
    "flags_of",
    "load_blueprint",
    "parse_blueprint",
]
