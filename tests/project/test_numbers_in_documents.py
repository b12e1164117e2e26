"""Numbers that pages state and the code decides: each is read out of its page and compared."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click import Context
from click.testing import CliRunner
from hypothesis import settings as profile

from pcmrs.authoring.trial.coverage import coverage
from pcmrs.authoring.trial.tour import plan_tour
from pcmrs.bus.bridge import CAPACITY
from pcmrs.bus.serving import ANSWERS
from pcmrs.bus.settings import STOPS
from pcmrs.cli import main
from pcmrs.cli.fsm.design import design
from pcmrs.cli.fsm.verify import verify
from pcmrs.console._geometry import FACES
from pcmrs.dispatcher.locks import MAX_WAITING
from pcmrs.fsm.verify._space import StateSpace
from pcmrs.gateway.intake import MAX_SESSIONS
from pcmrs.journal.group import MOST_WAITING
from pcmrs.service.supervisor import RESTARTS, WITHIN
from pcmrs.settings import Settings
from pcmrs.workflows._collision_checks import SAMPLES_PER_PART
from pcmrs_lab.campaign.catalogue import catalogue
from tests import ROOT
from tests.support.documents import documents
from tests.support.shipped import shipped_blueprint
from tests.support.trials import USUAL

WORDS = {"six": 6, "Seven": 7, "eight": 8, "nine": 9, "ten": 10}


def stated(page: str, pattern: str) -> list[tuple[str, ...]]:
    """What the groups of a pattern say on a page, whose line breaks count as spaces; at least one place."""
    found = [match.groups() for match in re.finditer(pattern, " ".join((ROOT / page).read_text().split()))]
    assert found, f"{page} has nothing of the form {pattern!r}"
    return found


def number(text: str) -> float:
    """A number as pages write it: a word, or digits with commas between thousands."""
    return WORDS[text] if text in WORDS else float(text.replace(",", ""))


def verified(name: str) -> tuple[int, ...]:
    """Joint states, transitions and properties of a workflow, as `pcmrs fsm verify` counts them."""
    space = StateSpace(shipped_blueprint(name), 100_000)
    return len(space.reached), space.taken, len(shipped_blueprint(name).properties)


def toured() -> tuple[int, ...]:
    """What `pcmrs fsm test ratms` counts, in the page's order; of the first six it prints both columns."""
    tour = plan_tour(shipped_blueprint("ratms"))
    counts = [count.total for count in coverage(shipped_blueprint("ratms"), [], tour.wanted).values()]
    commands = sum(len(stretch) for stretch in tour.stretches)
    return *(each for count in counts[:6] for each in (count, count)), commands, commands


def planned() -> tuple[int, ...]:
    """Landmarks and poses of the example plan, which the demo goes through."""
    plan = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())
    return len(plan["landmarks"]), len(plan["poses"])


def source(test: str) -> str:
    return (ROOT / "tests" / test).read_text()


def walked(file: str, test: str) -> int:
    """Number of seeds that a test walks through."""
    ((first, end),) = re.findall(rf"def {test}\(\) -> None:\n    walk\(range\((?:(\w+), )?(\w+)\)\)", source(file))
    return int(end) - int(first or 0)


def compared() -> tuple[int, ...]:
    """Workflows and charts that are compared with python-statemachine, in `make test` and nightly."""
    scxml, charts = "unit/authoring/exchange/exporting/test_scxml.py", "unit/authoring/exchange/importing/test_scxml.py"
    return (
        walked(scxml, "test_random_workflows"),
        walked(charts, "test_import_then_export_is_the_identity_on_behaviour"),
        walked(scxml, "test_many_random_workflows"),
        walked(charts, "test_import_then_export_of_many"),
    )


DEFECTS = ROOT / "tests" / "system" / "lab" / "exploring" / "defects"
SOUND = r"{}\.toml: sound: (\d+) joint states, (\d+) transitions, (\d+) properties"
TOUR = "".join(
    rf" {each} +(\d+) +(\d+)"
    for each in (
        "joint state and operation", "of these accepted", "of these rejected", "declared outcomes", "refusing checks",
        "failing steps",
    )
)  # fmt: skip
FLOODS = r"beyond ([\d,]+) puts and ([\d,]+) queries a second"
DECIDED: list[tuple[str, str, Callable[[], tuple[float, ...]]]] = [
    ("README.md", r"(\w+) State Branches;", lambda: (len(shipped_blueprint("ratms").branches),)),
    ("README.md", r"digitizes (\d+) landmarks, registers, and places the coil at (\d+) poses", planned),
    ("CHANGELOG.md", r"(\d+) examples instead of (\d+)", lambda: (profile.get_profile("nightly").max_examples, USUAL)),
    ("CHANGELOG.md", r"looked at in parts of (\d+) samples", lambda: (SAMPLES_PER_PART,)),
    ("docs/architecture.md", r"computed in parts of (\d+) samples", lambda: (SAMPLES_PER_PART,)),
    ("docs/campaign.md", r"faults of a catalogue of (\d+)", lambda: (len(catalogue()),)),
    ("docs/console.md", r"the body in the scene has ([\d,]+) triangles at most", lambda: (FACES,)),
    ("docs/explore.md", r"for each of the (\w+) defects", lambda: (len(list(DEFECTS.glob("*.json"))),)),
    ("docs/fsm.md", SOUND.format("ratms"), lambda: verified("ratms")),
    ("docs/fsm.md", TOUR + r" engine: (\d+) commands.*? dispatcher, steps outside: (\d+) commands", toured),
    (
        "docs/fsm.md",
        r"runs (\d+) random workflows .*? imports (\d+) random charts.*? more: ([\d,]+) workflows and ([\d,]+) charts",
        compared,
    ),
    ("docs/supervision.md", r"commands and requests \| (\d+) calls", lambda: (CAPACITY,)),
    ("docs/supervision.md", r"commands put on the bus \| (\d+) each", lambda: (ANSWERS,)),
    ("docs/supervision.md", r"commands that wait for locks \| (\d+)", lambda: (MAX_WAITING,)),
    ("docs/supervision.md", r"peers of the gateway \| (\d+) sessions", lambda: (MAX_SESSIONS,)),
    ("docs/supervision.md", r"rows that wait for the disk \| (\d+) rows", lambda: (MOST_WAITING,)),
    ("docs/workflows.md", SOUND.format("femoroplasty"), lambda: verified("femoroplasty")),
    *(
        (page, FLOODS, lambda: (STOPS["put"], STOPS["query"]))
        for page in ("docs/supervision.md", "docs/threat-model.md")
    ),
]
"""Page, what it states, and what the code says to the groups of that."""


@pytest.mark.parametrize(("page", "pattern", "decided"), DECIDED, ids=[page for page, _, _ in DECIDED])
def test_a_number_is_what_the_code_says(page: str, pattern: str, decided: Callable[[], tuple[float, ...]]) -> None:
    expected = decided()
    for groups in stated(page, pattern):
        assert tuple(number(text) for text in groups) == expected


@pytest.mark.parametrize("page", ["docs/devices.md", "docs/supervision.md", "docs/architecture.md"])
def test_documented_robot_deadman_time_is_its_default(page: str) -> None:
    for (seconds,) in stated(page, r"`robot\.deadman` \(([\d.]+) s"):
        assert float(seconds) == Settings().robot.deadman


def test_a_node_is_restarted_so_often_as_the_page_says() -> None:
    assert stated("docs/devices.md", r"restarts it, at most (\d+) times within (\d+) s") == [
        (str(RESTARTS), f"{WITHIN:g}")
    ]


WORKFLOWS = stated("docs/workflows.md", r"\| `(\w+)` \| [^|]+ \| (\d+) \|")


@pytest.mark.parametrize(("name", "joint_states"), WORKFLOWS)
def test_the_joint_states_of_a_workflow_are_so_many(name: str, joint_states: str) -> None:
    assert verified(name)[0] == int(joint_states)


def test_a_finding_is_shown_as_it_is_printed() -> None:
    ((taken, left),) = stated("docs/fsm.md", r"\$ sed 's/([^/]+)/([^/]+)/' ratms\.toml \| pcmrs fsm verify -")
    file = ROOT / "pcmrs" / "workflows" / "ratms.toml"
    broken = re.sub(taken, left.replace("\\", ""), file.read_text())
    shown = CliRunner().invoke(verify, ["-"], input=broken).stdout
    ((first, last),) = stated(
        "docs/fsm.md", r"(<stdin>:\d+:\d+: \w+: .+? there it is broken\.) .+? (<stdin>: unsound: \d+ findings?)"
    )
    assert shown.startswith(first)
    assert shown.endswith(f"{last}\n")


def test_every_fuzz_target_has_a_row() -> None:
    targets = {path.stem for path in (ROOT / "fuzz").glob("*.py")} - {"__init__", "running"}
    section = (ROOT / "docs" / "devices.md").read_text().partition("## Parsers under fuzz")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)) == targets
    ((hours,),) = stated("docs/devices.md", r"`make fuzz SECONDS=1800` does all in (\w+) hours")
    assert len(targets) * 1800 == number(hours) * 3600
    ((seconds,),) = stated("docs/devices.md", r"fuzzes all, and divides ([\d,]+) s by their number")
    assert f"SECONDS = {number(seconds):.0f}\n" in source("project/test_fuzz_corpora.py")


SCRIPTS = stated("docs/explore.md", r"\| `(\w+)` \| (\d+) \| (?:\d+|not searched again) \|")


@pytest.mark.parametrize(("name", "acts"), SCRIPTS)
def test_the_script_of_a_defect_has_so_many_acts(name: str, acts: str) -> None:
    assert len(json.loads((DEFECTS / f"{name}.json").read_text())["acts"]) == int(acts)


LEFT_OUT = 4
"""Seeds between two parts of a row."""


def test_searches_add_up() -> None:
    rows = stated(
        "docs/explore.md",
        r"\| \w{7}(?: to \w{7})? \| \w+ \| (\d+) to (\d+)(?:, in (\d+) parts)? \| ([\d,]+) \| ([\d.]+) h \| (\d+) \|",
    )
    for first, last, parts, sessions, _, _ in rows:
        left_out = LEFT_OUT * (int(parts or 1) - 1)
        assert int(last) - int(first) + 1 == number(sessions) + left_out
    ((hours, violations),) = stated(
        "docs/explore.md", r"These are ([\d.]+) of the 8 hours .*? The (\w+) violations have"
    )
    assert float(hours) == round(sum(float(row[4]) for row in rows), 1)
    assert number(violations) == sum(int(row[5]) for row in rows)


def test_a_finding_on_a_step_table_is_shown_as_it_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = r"\$ sed 's/(.+?)/(.+?)/' examples/ratms_steps\.toml >steps\.toml; pcmrs fsm design steps\.toml"
    ((taken, left, shown),) = stated("docs/fsm.md", command + " (.+?) …")
    table = (ROOT / "examples" / "ratms_steps.toml").read_text()
    (tmp_path / "steps.toml").write_text(re.sub(taken, left, table, count=1))
    monkeypatch.chdir(tmp_path)
    assert shown in CliRunner().invoke(design, ["steps.toml"]).output


TIMED = re.compile(r"\b(?:ms|µs|p50|p99|median|processor time, s)\b")
"""What the head of a table of measured times has."""
MADE_BY = re.compile(r"(benchmarks/\w+\.py)|\bpcmrs ([a-z]+)|\bmake ([a-z]+)|-m (tests[\w.]+)")
OPTIONS_OF = re.compile(r"(benchmarks/\w+\.py)((?: [\w.\"-]+)*)")


def tables_of_times() -> list[tuple[str, str, str]]:
    """Page, head and section of every table of times; a table begins after an empty line."""
    found = []
    for page in documents():
        for section in re.split(r"^(?=#+ )", page.read_text(), flags=re.MULTILINE):
            heads = re.findall(r"(?<=\n\n)\|.+(?=\n\| -)", section)
            found += [(page.relative_to(ROOT).as_posix(), head, section) for head in heads if TIMED.search(head)]
    return found


@pytest.mark.parametrize(("page", "head", "section"), tables_of_times(), ids=lambda text: text[:40])
def test_a_table_of_times_names_a_command_that_exists(page: str, head: str, section: str) -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    commands = set(main.list_commands(Context(main)))
    named = MADE_BY.findall(section)
    assert any(
        (benchmark and (ROOT / benchmark).is_file())
        or command in commands
        or target in targets
        or (module and (ROOT / module.replace(".", "/")).with_suffix(".py").is_file())
        for benchmark, command, target, module in named
    ), f"{page}: {head}: its section names {named}"


def test_options_of_benchmarks_on_pages_exist() -> None:
    wrong = []
    for page in documents():
        for benchmark, words in OPTIONS_OF.findall(" ".join(page.read_text().split())):
            program = (ROOT / benchmark).read_text() if (ROOT / benchmark).is_file() else ""
            wrong += [f"{page.name}: {benchmark} {word}" for word in words.split() if unknown_option(word, program)]
    assert wrong == []


def unknown_option(word: str, program: str) -> bool:
    return word.startswith("--") and f'"{word}"' not in program
