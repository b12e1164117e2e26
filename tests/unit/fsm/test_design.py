"""From step tables to blueprints: the paper's example, an ordered grid, and what is wrong with a table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import pcmrs
from pcmrs.authoring.design import Design, design
from pcmrs.authoring.design.branches import DesignedBranch
from pcmrs.authoring.design.count import excess_of
from pcmrs.cli.fsm.design import design as command
from pcmrs.fsm import Blueprint, Closure, Engine, examine, load_blueprint, parse_blueprint
from pcmrs.fsm.blueprint import BranchSpec, SequenceSpec
from pcmrs.fsm.codes import DESIGN
from pcmrs.fsm.files.load import BlueprintExamination
from pcmrs.fsm.finding import Finding
from tests import ROOT
from tests.support.trials import examples

EXAMPLES = ROOT / "examples"
WORKFLOWS = Path(pcmrs.__file__).parent / "workflows"
RATMS_STEPS = (EXAMPLES / "ratms_steps.toml").read_bytes()
GRID_STEPS = (EXAMPLES / "grid_steps.toml").read_bytes()
HEEDED = {"safety": "watched"}
"""State of the branch that releases Stop, where a table has steps that it bars."""

CLEARED_BEFORE = {("registration", "clear_landmarks", "000"), ("toolplan", "clear", "0")}
"""What ratms.toml also accepts where nothing is there to be cleared."""


def blueprint_of(raw: bytes) -> Blueprint:
    result = design(raw, origin="steps.toml")
    assert not result.findings, [str(finding) for finding in result.findings]
    return parse_blueprint(result.text.encode())


def table(*steps: dict[str, Any], **keys: Any) -> bytes:
    return tomli_w.dumps({"id": "demo", "version": "1", "steps": [step("a") | each for each in steps], **keys}).encode()


def step(name: str, *needs: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "operation": f"do_{name}", "depends_on": list(needs)} | declared(keys)


def declared(keys: dict[str, Any]) -> dict[str, Any]:
    """The keys, with a declaration unless they have one or the step is done by the steps that refine it."""
    return keys if "steps" in keys.get("refined_by", {}) else {"moves": False} | keys


def accepted(engine: Engine, branches: list[str]) -> dict[tuple[str, ...], dict[tuple[str, str], set[tuple[str, ...]]]]:
    """For each reachable joint state, where its accepted operations lead; all by the states of some branches only."""
    found: dict[tuple[str, ...], dict[tuple[str, str], set[tuple[str, ...]]]] = {}
    waiting, seen = [engine.joint()], set()
    while waiting:
        joint = waiting.pop()
        if tuple(joint.values()) in seen:
            continue
        seen.add(tuple(joint.values()))
        here = found.setdefault(tuple(joint[branch] for branch in branches), {})
        for branch, spec in engine.blueprint.branches.items():
            for operation in (name for name, each in spec.operations.items() if not each.iio):
                engine.place(joint)
                answer = engine.ask(branch, operation)
                if isinstance(answer, Closure):
                    waiting += [dict(change.states) for change in answer.outcomes.values()]
                    ends = {tuple(change.states[each] for each in branches) for change in answer.outcomes.values()}
                    here.setdefault((branch, operation), set()).update(ends)
    return found


def test_the_papers_table_has_8_of_16_combinations() -> None:
    result = design(RATMS_STEPS)
    assert str(result.combinations) == (
        "8 of the 16 combinations of 4 steps are possible.\n"
        "  4 have landmarks_digitized without landmarks_planned.\n"
        "  4 have registered without landmarks_digitized."
    )
    assert examine(result.text.encode()).joint_states == 8


def test_the_papers_table_becomes_what_was_written_by_hand() -> None:
    branches = ["registration", "digitization", "toolplan"]
    by_hand = accepted(Engine(load_blueprint(WORKFLOWS / "ratms.toml")), branches)
    designed = accepted(Engine(blueprint_of(RATMS_STEPS)), branches)
    assert set(designed) == set(by_hand)
    common = {operation for here in designed.values() for operation in here}
    assert len(common) == 13
    for joint, operations in by_hand.items():
        states = dict(zip(branches, joint, strict=True))
        ends = {key: value for key, value in operations.items() if key in common}
        for branch, operation, state in CLEARED_BEFORE:
            if states[branch] == state:
                del ends[branch, operation]
        assert designed[joint] == ends, joint


def test_step_needs_its_dependencies_and_a_grid_goes_in_order() -> None:
    engine = Engine(blueprint_of(GRID_STEPS))
    assert engine.allowed("grid") == ["reinit"]
    for branch, operation in [
        ("preparation", "plan_landmarks"),
        ("preparation", "plan"),
        ("digitization", "digitize_all"),
        ("preparation", "register"),
    ]:
        assert engine.allowed("grid") == ["reinit"]
        engine.perform(branch, operation)
    engine.perform("grid", "perform")
    engine.perform("grid", "perform", "failed")
    assert engine.joint()["grid"] == "point_2_stopped"
    assert engine.allowed("grid") == ["repeat", "skip", "abandon", "reinit"]
    for _ in range(8):
        assert engine.joint()["preparation"] == "11110"
        engine.perform("grid", "skip")
    assert engine.joint() == {"preparation": "11111", "digitization": "1", "grid": "done", **HEEDED}


def test_doing_a_step_again_begins_what_rests_on_it_again() -> None:
    blueprint = blueprint_of(GRID_STEPS)
    engine = Engine(blueprint)
    start = {"preparation": "11110", "digitization": "1", **HEEDED}
    for operation in ("register", "plan"):
        engine.place(start | {"grid": "point_5_stopped"})
        engine.perform("preparation", operation)
        assert engine.joint() == start | {"grid": "point_1"}
    engine.place({"preparation": "11111", "digitization": "1", "grid": "done"})
    engine.perform("digitization", "digitize_all")
    assert engine.joint() == {"preparation": "11010", "digitization": "1", "grid": "point_1", **HEEDED}


def test_independent_chains_are_parallel_branches() -> None:
    blueprint = blueprint_of(table(step("a"), step("x"), step("b", "a", title="Bee"), step("y", "x", branch="other")))
    assert {name: list(branch.states) for name, branch in blueprint.branches.items()} == {
        "procedure": ["00", "10", "11"],
        "other": ["00", "10", "11"],
    }
    assert blueprint.branches["procedure"].flags == ["a", "b"]
    assert blueprint.branches["procedure"].states["11"] == "a, Bee"
    assert blueprint.goal == {"procedure": ["11"], "other": ["11"]}


def test_no_branch_takes_the_name_of_a_step() -> None:
    blueprint = blueprint_of(table(step("a"), step("x"), step("b", "a")))
    assert list(blueprint.branches) == ["procedure", "procedure_2"]


def test_roles_criteria_and_deadlines_arrive_at_the_operation() -> None:
    keys = {"roles": ["operator"], "checks": ["c"], "steps": ["s"], "payload": "p", "timeout_s": 7}
    blueprint = blueprint_of(table(step("a", reopened_by=["undo"], **keys)))
    operations = blueprint.branches["procedure"].operations
    made = operations["do_a"]
    assert (made.roles, made.checks, made.steps, made.payload, made.timeout_s) == (["operator"], ["c"], ["s"], "p", 7)
    assert operations["undo"].roles == ["operator"]


def test_one_operation_may_reopen_several_steps() -> None:
    raw = table(step("a", reopened_by=["clear"]), step("b", "a"), step("c", "a", reopened_by=["clear"]), step("d", "c"))
    engine = Engine(blueprint_of(raw))
    engine.place({"procedure": "1111"})
    engine.perform("procedure", "clear")
    assert engine.joint() == {"procedure": "0000"}


def test_many_steps_are_counted_without_being_listed() -> None:
    chain = [step(f"s{i}", *([f"s{i - 1}"] if i else [])) for i in range(30)]
    result = design(table(*chain, step("x", branch="apart")))
    assert result.combinations is not None
    assert (result.combinations.steps, result.combinations.possible) == (31, 62)
    assert result.combinations.possible + sum(each.count for each in result.combinations.impossible) == 2**31


REFINED = {"branch": "in_b", "steps": [step("b1"), step("b2", "b1")]}
FAULTS: dict[str, tuple[bytes, str, str]] = {
    "no steps": (b'id = "x"\nversion = "1"\nsteps = []\n', "step_count", "steps"),
    "too many steps": (table(*(step(f"s{i}") for i in range(257))), "step_count", "steps"),
    "too many in one branch": (
        table(step("s0"), *(step(f"s{i}", f"s{i - 1}") for i in range(1, 33))),
        "step_count",
        "steps.0",
    ),
    "too many combinations": (
        table(step("s0"), *(step(f"s{i}", "s0") for i in range(1, 14))),
        "step_count",
        "steps.0",
    ),
    "too many joint states": (table(*(step(f"s{i}") for i in range(21))), "step_count", "steps"),
    "twice": (table(step("a"), step("a", operation="other")), "step_name", "steps.1.name"),
    "twice below": (table(step("b1"), step("b", refined_by=REFINED)), "step_name", "steps.1.refined_by.steps.0.name"),
    "unknown": (table(step("a"), step("b", "nobody")), "step_unknown", "steps.1.depends_on.0"),
    "of another level": (table(step("b", refined_by=REFINED), step("c", "b1")), "step_unknown", "steps.1.depends_on.0"),
    "cycle": (table(step("a", "c"), step("b", "a"), step("c", "b")), "step_cycle", "steps.0.depends_on"),
    "needs itself": (table(step("a", "a")), "step_cycle", "steps.0.depends_on"),
    "cycle below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", "q"), step("q", "p")]})),
        "step_cycle",
        "steps.0.refined_by.steps.0.depends_on",
    ),
    "two branches": (table(step("a", branch="x"), step("b", "a", branch="y")), "step_branch", "steps.1.branch"),
    "branch below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", branch="y")]})),
        "step_branch",
        "steps.0.refined_by.steps.0.branch",
    ),
    "one branch for two": (table(step("a", branch="x"), step("b", branch="x")), "name_collision", "steps.1"),
    "same operation": (table(step("a"), step("b", "a", operation="do_a")), "name_collision", "steps.1.operation"),
    "own reinit": (table(step("a", operation="reinit")), "name_collision", "steps.0.operation"),
    "reopened by doing": (table(step("a", reopened_by=["do_a"])), "name_collision", "steps.0.reopened_by.0"),
    "empty refinement": (table(step("b", refined_by={"branch": "in_b"})), "step_refinement", "steps.0.refined_by"),
    "points not performed": (
        table(step("b", refined_by={"branch": "in_b", "points": 3})),
        "step_refinement",
        "steps.0.refined_by",
    ),
    "refined and done": (table(step("b", refined_by=REFINED, checks=["c"])), "step_refinement", "steps.0"),
    "no points": (
        table(step("b", steps=["s"], refined_by={"branch": "in_b", "points": 0})),
        "bad_sequence",
        "steps.0.refined_by.points",
    ),
    "point twice": (
        table(step("b", steps=["s"], refined_by={"branch": "in_b", "points": ["p", "p"]})),
        "bad_sequence",
        "steps.0.refined_by.points.1",
    ),
    "python word": (table(step("a", operation="class")), "reserved_name", "steps.0.operation"),
    "bad id": (table(step("a"), id="x.y"), "bad_name", "id"),
    "bad deadline": (table(step("a", timeout_s=-1)), "bad_operation", "steps.0.operation"),
    "says nothing of the patient": (
        tomli_w.dumps({"id": "x", "version": "1", "steps": [{"name": "a", "operation": "do_a"}]}).encode(),
        "step_undeclared",
        "steps.0",
    ),
    "taken back by steps that say nothing": (
        table(step("a", reopened_by=[{"operation": "undo", "steps": ["s"]}])),
        "step_undeclared",
        "steps.0.reopened_by.0",
    ),
    "refined, and moves itself": (table(step("b", moves=True, refined_by=REFINED)), "step_hazard", "steps.0"),
    "moves below": (
        table(step("b", refined_by={"branch": "in_b", "steps": [step("p", moves=True)]})),
        "step_hazard",
        "steps.0.refined_by.steps.0",
    ),
    "irreversible by points": (
        table(step("b", irreversible=True, steps=["s"], refined_by={"branch": "in_b", "points": 2})),
        "step_hazard",
        "steps.0",
    ),
    "irreversible in several goes": (
        table(step("b", irreversible=True, alternatives=[{"operation": "try_b", "partial": True}])),
        "step_hazard",
        "steps.0.alternatives.0",
    ),
    "irreversible, and takes it back": (
        table(step("b", reopened_by=[{"operation": "undo", "irreversible": True}])),
        "step_hazard",
        "steps.0.reopened_by.0",
    ),
    "refined twice behind a motion": (
        table(
            step("a", moves=True),
            step(
                "b",
                "a",
                refined_by={
                    "branch": "in_b",
                    "steps": [step("p", refined_by={"branch": "in_p", "steps": [step("q")]})],
                },
            ),
        ),
        "step_hazard",
        "steps.1.refined_by",
    ),
    "unknown key": (table(step("a", colour="red")), "bad_value", "steps.0.colour"),
    "not TOML": (b'id = "x"\nsteps = [', "not_toml", ""),
    "not UTF-8": (b'id = "\xff"', "not_utf8", ""),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_where_it_is(name: str) -> None:
    raw, code, path = FAULTS[name]
    result = design(raw, origin="steps.toml")
    assert (result.text, {finding.code for finding in result.findings}) == ("", {code})
    finding = result.findings[0]
    assert finding.file == "steps.toml"
    assert ".".join(finding.path) == path, str(finding)


def test_there_is_a_table_for_every_kind_of_finding() -> None:
    assert {code for _, code, _ in FAULTS.values()} >= set(DESIGN)


def test_a_finding_has_line_and_column() -> None:
    raw = RATMS_STEPS.replace(b'["landmarks_digitized"]', b'["landmarks_digitised"]')
    (finding,) = design(raw, origin="steps.toml").findings
    line = raw.decode().splitlines()[finding.line - 1]
    assert line[finding.column - 1 :] == '"landmarks_digitised"]'
    assert str(finding).startswith(f"steps.toml:{finding.line}:{finding.column}: step_unknown: registered depends on")


ANY_STEP = st.fixed_dictionaries(
    {"name": st.sampled_from(["a", "b", "c", "class", ""]), "operation": st.sampled_from(["go", "do", "reinit", "ö"])},
    optional={
        "depends_on": st.lists(st.sampled_from(["a", "b", "c"]), max_size=2),
        "reopened_by": st.lists(st.sampled_from(["clear", "go", "x.y"]), max_size=2),
        "branch": st.sampled_from(["", "one", "two", "b-b"]),
        "timeout_s": st.floats(),
        "refined_by": st.fixed_dictionaries(
            {"branch": st.sampled_from(["one", "three", "a"])},
            optional={"points": st.integers(-1, 3) | st.lists(st.sampled_from(["p", "done", "q"]), max_size=2)},
        ),
        "steps": st.just(["s"]),
        "moves": st.sampled_from([True, False, "retreat"]),
        "affects_patient": st.booleans(),
        "irreversible": st.booleans(),
        "confirm": st.booleans(),
    },
)
MUTATION = st.tuples(st.integers(0, len(RATMS_STEPS)), st.integers(0, 12), st.binary(max_size=6))


def check_answer(result: Design) -> None:
    assert bool(result.text) != bool(result.findings)
    for finding in result.findings:
        assert finding.line >= 1, str(finding)
        assert finding.file == "steps"
    if result.text:
        assert parse_blueprint(result.text.encode()).branches


@examples(150)
@given(st.lists(ANY_STEP, max_size=4), st.text(max_size=3), st.text(max_size=3))
def test_any_table_ends_in_a_sound_blueprint_or_findings(steps: list[Any], name: str, version: str) -> None:
    check_answer(design(tomli_w.dumps({"id": name, "version": version, "steps": steps}).encode(errors="replace")))


@examples(40)
@given(st.lists(MUTATION, min_size=1, max_size=3))
def test_any_bytes_end_in_a_sound_blueprint_or_findings(mutations: list[tuple[int, int, bytes]]) -> None:
    raw = RATMS_STEPS
    for place, length, new in mutations:
        raw = raw[:place] + new + raw[place + length :]
    check_answer(design(raw))


def test_command_writes_the_blueprint_and_counts_combinations(tmp_path: Path) -> None:
    """It reports how many combinations of steps are possible."""
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, [str(EXAMPLES / "ratms_steps.toml"), "-o", str(output)])
    assert result.exit_code == 0
    assert result.stdout.startswith("8 of the 16 combinations of 4 steps are possible.")
    assert load_blueprint(output).id == "ratms_steps"


def test_command_writes_only_the_blueprint_to_standard_output() -> None:
    result = CliRunner().invoke(command, ["-"], input=RATMS_STEPS)
    assert result.exit_code == 0
    assert parse_blueprint(result.stdout.encode()).id == "ratms_steps"
    assert result.stderr.startswith("8 of the 16")


@pytest.mark.parametrize(("raw", "status"), [(table(step("a", "b")), 1), (b"no table", 2), (b'id = "x"', 2)])
def test_the_command_ends_with_findings(raw: bytes, status: int, tmp_path: Path) -> None:
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, ["-", "-o", str(output)], input=raw)
    assert result.exit_code == status
    assert result.stderr.startswith("<stdin>:")
    assert not output.exists()


def test_the_command_says_in_json_what_came_of_it(tmp_path: Path) -> None:
    output = tmp_path / "blueprint.toml"
    result = CliRunner().invoke(command, ["-", "--json", "-o", str(output)], input=RATMS_STEPS)
    said = json.loads(result.stdout)
    assert (result.exit_code, said["file"], said["readable"], said["sound"], said["findings"]) == (
        0, "<stdin>", True, True, [],
    )  # fmt: skip
    assert (said["combinations"]["steps"], said["combinations"]["possible"]) == (4, 8)
    assert said["combinations"]["impossible"][1] == {"step": "registered", "missing": "landmarks_digitized", "count": 4}
    assert load_blueprint(output).id == "ratms_steps"
    refused = CliRunner().invoke(command, ["-", "--json"], input=table(step("a", "b")))
    said = json.loads(refused.stdout)
    assert (refused.exit_code, said["readable"], said["sound"], said["combinations"]) == (1, True, False, None)
    assert [finding["code"] for finding in said["findings"]] == ["step_unknown"]


def refined(number: int, points: int) -> list[dict[str, Any]]:
    """Steps of points each."""
    return [step(f"s{i}", steps=["s"], refined_by={"branch": f"b{i}", "points": points + i % 2}) for i in range(number)]


@pytest.mark.parametrize(
    ("raw", "said", "where"),
    [
        (
            table(*refined(11, 990)),
            "10895 items; the limit is 10000. Most is from b1, with 991 points.",
            b"points = 991",
        ),
        (
            table(step("root"), *(step(f"s{i}", "root") for i in range(10))),
            "Most is from procedure, with 1025 states.",
            b"[[steps]]",
        ),
    ],
)
def test_too_large_a_blueprint_is_reported_at_the_causing_step(raw: bytes, said: str, where: bytes) -> None:
    result = design(raw)
    assert [finding.code for finding in result.findings] == ["step_count"]
    assert raw.splitlines()[result.findings[0].line - 1] == where
    assert said in result.findings[0].text
    assert result.combinations is not None


def test_too_many_joint_states_are_reported_at_the_excess_points() -> None:
    path = ("steps", "0")
    branches = [
        DesignedBranch("b", BranchSpec(sequence=SequenceSpec(count=9)), path),
        DesignedBranch("a", BranchSpec(), path),
    ]
    examination = BlueprintExamination(
        Blueprint(id="x", version="1", branches={}), [Finding(code="too_many_states", text="Much.")]
    )
    excess = excess_of(examination, 1, branches)
    assert excess == Finding(
        code="step_count", text="Much. Most is from b, with 9 points.", path=(*path, "refined_by", "points")
    )


def test_a_number_of_too_many_digits_has_its_place() -> None:
    (finding,) = design(b'id = "x"\nversion = ' + b"1" * 5000 + b"\n").findings
    assert (finding.code, finding.line, finding.column) == ("not_toml", 2, 11)
    assert finding.text == "This is not TOML: a number has over 4300 digits."
