"""Keys of a branch, an operation or a property that contradict each other, each reported where it is."""

from __future__ import annotations

import pytest

from tests.unit.fsm.needle_workflow import PLAIN, found
from tests.unit.fsm.rules.small_workflow import Fault, check_fault

FAULTS: dict[str, Fault] = {
    "level without parent": (
        "[branches.side]\nlevel = 1",
        "[branches.side]\nlevel = 2",
        "bad_level",
        "side",
        "level",
    ),
    "level skipped": ("[branches.sub]\nlevel = 2", "[branches.sub]\nlevel = 3", "bad_level", "level 3", "level = 3"),
    "compatible incomplete": (', "1" = ["11"] }', " }", "bad_level", "missing: 1", "compatible"),
    "from empty": ('from = ["safe"]', "from = []", "bad_operation", "`from`", "side.operations.move"),
    "from star and more": ('from = ["safe"]', 'from = ["*", "safe"]', "bad_operation", "`from`", "operations.move"),
    "target of another source": (
        'to = "near"\nmotion',
        'to = { near = "near" }\nmotion',
        "bad_operation",
        "['safe'], not ['near']",
        "operations.move",
    ),
    "neither to nor outcomes": ('to = "near"\nmotion', "motion", "bad_operation", "outcomes", "operations.move"),
    "both to and outcomes": (
        'to = "near"\nmotion',
        'to = "near"\noutcomes = { a = { to = "near" } }\nmotion',
        "bad_operation",
        "`outcomes`",
        "operations.move",
    ),
    "diverts a revocation that there is not": (
        '[branches.side.operations.withdraw]\nfrom = ["near", "held"]\nto = "safe"',
        '[branches.side.operations.withdraw]\nfrom = ["near", "held"]\n'
        'outcomes = { all = { to = "safe", revoked_to = { top = "00" } } }',
        "bad_operation",
        "no revocation of top names side",
        "side.operations.withdraw",
    ),
    "no time": ("motion =", "timeout_s = 0\nmotion =", "bad_operation", "timeout_s = 0", "operations.move"),
    "time is no number": ("motion =", "timeout_s = nan\nmotion =", "bad_operation", "nan", "operations.move"),
    "time without end": ("motion =", "timeout_s = inf\nmotion =", "bad_operation", "inf", "operations.move"),
    "event that moves": ("motion =", "event = true\nmotion =", "bad_operation", "no user asks", "operations.move"),
    "motion without failure": ('on_failure = "held"\n', "", "bad_operation", "on_failure", "operations.move"),
    "motion without doubt": ('on_unknown = "held"\n', "", "bad_operation", "on_unknown", "operations.move"),
    "motion without steps": ('steps = ["follow"]\n', "", "bad_operation", "no steps", "operations.move"),
    "motion that fails to where it began": (
        'on_failure = "held"',
        'on_failure = "safe"',
        "bad_operation",
        "may fail to safe, where the approach move is valid",
        "operations.move",
    ),
    "only a motion could release Stop": (
        "unlatches = true\n",
        "unlatches = true\naffects_patient = true\n",
        "no_release",
        "neither moves nor affects the patient",
        "operations.clear",
    ),
    "iio with steps": (
        'to = "11"\niio = true',
        'to = "11"\niio = true\nsteps = ["a"]',
        "bad_operation",
        "iio",
        "reached",
    ),
    "iio as event": (
        'to = "11"\niio = true',
        'to = "11"\niio = true\nevent = true',
        "bad_operation",
        "(iio)",
        "top.operations.reached",
    ),
    "sets no child": (
        "[branches.top.operations.clear]",
        '[branches.top.operations.clear]\nsets = { side = "safe" }',
        "bad_operation",
        "sets side",
        "operations.clear",
    ),
    "property of nothing": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"',
        "bad_property",
        "exactly one",
        "properties",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_where_it_is(fault: str) -> None:
    check_fault(FAULTS[fault])


CONTRADICTIONS: dict[str, tuple[str, str]] = {
    "after a failure it is unknown how far it got": ("irreversible = true", 'irreversible = true, steps = ["cut"]'),
    "a device cannot do it": ("irreversible = true", "irreversible = true, event = true"),
    "what is allowed again must be irreversible": ('allows_again = ["sample"]', 'allows_again = ["insert"]'),
    "nothing irreversible allows it": ("irreversible = true", 'irreversible = true, allows_again = ["sample"]'),
    "no event is confirmed": ('allows_again = ["sample"]', "event = true, confirm = true"),
}


@pytest.mark.parametrize("fault", CONTRADICTIONS)
def test_contradictory_hazard_marks_are_refused(fault: str) -> None:
    old, new = CONTRADICTIONS[fault]
    codes = {code for code, _ in found(PLAIN.replace(old, new))}
    assert codes == {"bad_operation"}
