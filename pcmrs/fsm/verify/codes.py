"""Kinds of findings that only a search through the joint states brings to light."""

from __future__ import annotations

CODES = {
    "too_many_states": "There are more joint states than the verification may look at.",
    "endless_cascade": "A command triggers changes that trigger changes without an end.",
    "no_outcome": "An operation is accepted where it cannot end in any declared way.",
    "ambiguous_revocation": "Two revocations of a branch hold at once and lead to different states.",
    "order_dependent": "What a command does depends on the order of the branches in the file.",
    "unreachable_state": "A branch never gets into a state.",
    "never_accepted": "An operation is accepted in no joint state.",
    "never_called": "An operation that only children call is called by none.",
    "deadlock": "Nothing that a user may ask for is accepted any more, and the goal is not reached.",
    "goal_unreachable": "No sequence of commands reaches the goal.",
    "goal_lost": "The goal can no longer be reached.",
    "cannot_conclude": "An operation that runs can be found where none of its endings is allowed.",
    "property_violated": "A property does not hold.",
}
