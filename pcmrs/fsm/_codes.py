"""All codes of findings, by which a program can tell what is wrong with a workflow."""

from __future__ import annotations

READING = {
    "cannot_be_read": "There is no such file or workflow, or it cannot be opened.",
    "too_large": "A file is too large.",
    "too_deep": "A file is nested too deeply.",
    "not_utf8": "A text file is not in UTF-8.",
    "not_toml": "A file is not TOML.",
    "bad_value": "A key is unknown or missing, or a value has the wrong type.",
    "bad_extends": "The file that a blueprint extends is not beside it, cannot be opened, or extends another itself.",
    "bad_sequence": "An ordered list has no items, too many, or some that cannot be states.",
}
RULES = {
    "bad_name": "A name has characters that the bus or Python cannot carry.",
    "reserved_name": "A name is a word of Python or of PCMRS.",
    "name_collision": "Two names would be the same, in Python or as a flag.",
    "no_branches": "A workflow has no branches.",
    "no_states": "A branch has no states.",
    "bad_flags": "A state does not have one digit for each flag.",
    "bad_level": "A level does not fit the parent, or `compatible` leaves a state out.",
    "unknown_branch": "A branch is named that does not exist.",
    "unknown_state": "A state is named that does not exist.",
    "unknown_operation": "An operation is named that does not exist.",
    "bad_operation": "An operation is declared in a contradictory way.",
    "bad_activity": "An activity is declared in a contradictory way, or another motion could run beside it.",
    "bad_timer": "A timer is declared in a contradictory way, or posts something other than an event.",
    "bad_property": "A property is declared in a contradictory way.",
    "bad_stage": "A stage is declared in a contradictory way.",
    "undeclared": "An operation or activity does not declare that it moves the robot or affects the patient.",
    "latch_ignored": "An operation that moves or affects the patient would be allowed while Stop is latched.",
    "no_release": "After a Stop, the latch that it sets could not be released.",
    "rule_1": "A state above level 1 has no re-initiation.",
    "rule_2": "A change at a higher level calls nothing of the level below.",
    "rule_3": "A branch does not fit its parent where both start.",
}
VERIFICATION = {
    "too_many_states": "There are more joint states than the verification may look at.",
    "endless_cascade": "A command triggers changes that trigger changes without an end.",
    "no_outcome": "An operation is accepted where it cannot end in any declared way.",
    "ambiguous_revocation": "Two revocations of a branch hold at once and lead to different states.",
    "order_dependent": "The effect of a command depends on the order of the branches in the file.",
    "unreachable_state": "No command leads to a state.",
    "never_accepted": "An operation is accepted in no joint state.",
    "never_called": "An operation that only children call is called by none.",
    "deadlock": "Nothing that a user may ask for is accepted any more, and the goal is not reached.",
    "goal_unreachable": "No sequence of commands reaches the goal.",
    "goal_lost": "The goal can no longer be reached.",
    "stage_lost": "A stage that belongs to the procedure can no longer be reached.",
    "no_way_back": "No operation leads back to a safe state.",
    "repeatable": "An irreversible operation can be done again without an operation that allows it.",
    "activity_stuck": "An activity may end by itself where the operation for that is denied.",
    "timer_stuck": "A timer may expire where the event that it posts is denied.",
    "cannot_conclude": "An operation that runs can be found where none of its endings is allowed.",
    "property_violated": "A property does not hold.",
    "vacuous_property": "The `when` of a property holds at no reachable moment.",
}
DESIGN = {
    "step_count": "A step table has no steps, or more than can be designed with.",
    "step_name": "A step has the name of another.",
    "step_unknown": "A step depends on one that does not exist.",
    "step_cycle": "Steps depend on each other in a circle.",
    "step_branch": "Steps are assigned to a branch to which they cannot belong.",
    "step_undeclared": "A step does not say whether it moves the robot, affects the patient or can be undone.",
    "step_hazard": "A step that reaches the patient or cannot be undone is in a place where that cannot be tracked.",
    "step_refinement": "A step is refined in a contradictory way.",
}
DRAFT = {
    "draft_answer": "A model has answered with something other than a step table.",
    "draft_code": "A draft names functions, which only its engineers may add.",
    "draft_source": "A step or requirement of a draft names no sentence of the protocol that it comes from.",
    "draft_unresolved": "A draft has findings that were not resolved.",
}
EXCHANGE = {
    "not_xml": "A file is not well-formed XML.",
    "not_scxml": "An XML file is not SCXML.",
    "not_drawio": "An XML file is not a draw.io diagram, or its compressed part cannot be read.",
    "not_mermaid": "A line is not part of a Mermaid state diagram.",
    "not_supported": "A file has something that a blueprint cannot express.",
    "no_start": "A drawing does not say where it starts.",
}
WARNINGS = {
    "old_key": "A key has its old name, which is still accepted.",
}
"""Codes of warnings, which a sound workflow can have."""

CODES = READING | RULES | VERIFICATION | DESIGN | DRAFT | EXCHANGE | WARNINGS
