"""What the documents name is there: tests, rows of the campaign, requirements, and the software of a cell."""

import re
import tomllib
from pathlib import Path

import pytest

from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.campaign.explore.invariants import INVARIANTS
from tests import ROOT
from tests.mutants.listed_guards import listed
from tests.support.documents import CODE, NAMED, NONE, ROW, SOURCES, promises, rows_of

THREATS = ROOT / "docs" / "threat-model.md"
SAFETY = ROOT / "docs" / "safety.md"
SEMANTICS = ROOT / "docs" / "semantics.md"
SUPERVISION = ROOT / "docs" / "supervision.md"
THREAT_TABLES = ("Threats from a network", "Threats on the machine")


def all_threats() -> list[list[str]]:
    return [row for heading in THREAT_TABLES for row in rows_of(THREATS.read_text(), heading)]


@pytest.mark.parametrize("document", [THREATS, SAFETY, SEMANTICS, SUPERVISION], ids=lambda path: path.stem)
def test_every_test_that_is_named_exists(document: Path) -> None:
    named = NAMED.findall(document.read_text())

    assert named
    for file, test, _ in named:
        assert re.search(rf"^(async )?def {test}\(", (ROOT / "tests" / file).read_text(), re.MULTILINE), (file, test)


def invariants() -> set[str]:
    """Names of what the explorer asks in its sessions."""
    sources = (ROOT / "lab" / "pcmrs_lab" / "campaign" / "explore").glob("*.py")
    watched = {name for path in sources for name in re.findall(r'_break\(\s*"(\w+)"', path.read_text())}
    return watched | {each.__name__ for group in INVARIANTS.values() for each in group}


def mutants() -> set[str]:
    """Names of the guards that are taken out of the product, by the tests and by the explorer's."""
    tables = [tomllib.loads(path.read_text()) for path in (ROOT / "tests" / "mutants" / "listed").rglob("*.toml")]
    exploring = (ROOT / "tests" / "system" / "lab" / "exploring").glob("*mutants*.py")
    found = {name for path in exploring for name in re.findall(r"^def (\w+)\(", path.read_text(), re.MULTILINE)}
    return found | {each["name"] for table in tables for each in table["mutant"]}


@pytest.mark.parametrize(
    ("document", "heading", "promises"),
    [
        (SAFETY, "Requirements and their tests", 26),
        (SEMANTICS, "What holds", 15),
        (SUPERVISION, "What is promised", 15),
    ],
    ids=lambda value: getattr(value, "stem", None),
)
def test_every_promise_names_a_test_an_invariant_and_a_mutant(document: Path, heading: str, promises: int) -> None:
    rows = rows_of(document.read_text(), heading)

    assert len(rows) == promises
    for row in rows:
        *_, shown, watched, without = row
        assert NAMED.search(shown), row
        for cell, known in ((watched, invariants()), (without, mutants())):
            assert NONE.fullmatch(cell) or CODE.search(cell), row
            assert set(CODE.findall(cell)) <= known, row


def test_mutants_of_a_requirement_are_named_with_it() -> None:
    """`none:` is refused where a listed mutant breaks the requirement."""
    named = {promise.id: set(CODE.findall(promise.without)) for source in SOURCES for promise in promises(source)}
    breaking = [each for each in listed() if each.requirement]

    assert [(each.name, each.requirement) for each in breaking if each.name not in named[each.requirement]] == []
    assert {each.requirement for each in breaking} >= {"SR8"}


def test_every_threat_has_a_control_and_what_shows_it() -> None:
    threats = all_threats()

    assert [row[0] for row in threats] == [f"X{number}" for number in range(1, len(threats) + 1)]
    for _, threat, assets, control, shown in threats:
        assert threat
        assert control
        assert set(assets.split()) <= set("MSWJKPV")
        assert NAMED.search(shown) or ROW.search(shown), threat


@pytest.mark.parametrize(
    ("document", "heading"),
    [(SAFETY, "Requirements and their tests"), *((THREATS, heading) for heading in THREAT_TABLES)],
    ids=lambda value: getattr(value, "stem", value),
)
def test_a_table_with_rows_says_that_they_are_nightly(document: Path, heading: str) -> None:
    section = document.read_text().partition(f"## {heading}\n")[2].partition("\n## ")[0]
    head = section.partition("\n|")[0]

    assert any(
        ROW.search(NAMED.sub("", row[-3 if document == SAFETY else -1]))
        for row in rows_of(document.read_text(), heading)
    )
    assert "Whole rows are run by `make nightly` only" in " ".join(head.split())


def test_the_page_of_faults_says_that_rows_are_nightly() -> None:
    before = (ROOT / "docs" / "faults.md").read_text().partition("## Sensor rows")[0]

    assert "Whole rows are run by `make nightly` only" in " ".join(before.split())


def test_every_row_of_the_campaign_that_is_named_exists() -> None:
    shown = [row[4] for row in all_threats()]
    shown += [row[3] for row in rows_of(SAFETY.read_text(), "Requirements and their tests")]

    for cell in shown:
        assert set(ROW.findall(NAMED.sub("", cell))) <= catalogue().keys(), cell


def test_every_row_against_an_adversary_is_answered() -> None:
    wanted = {row.id for row in catalogue().values() if row.fault_class == "adversary"}

    assert wanted <= set(ROW.findall(THREATS.read_text()))


def test_hazards_have_controls_and_requirements_have_hazards() -> None:
    text = SAFETY.read_text()
    hazards, requirements = rows_of(text, "Hazards"), rows_of(text, "Requirements and their tests")
    known = {row[0] for row in requirements}

    for name, *_, before, controls, after in hazards:
        assert set(controls.split(", ")) <= known, name
        assert re.fullmatch(r"S[1-4] P[1-4]", before), name
        assert re.fullmatch(r"S[1-4] P[1-4]", after), name
        assert (after[:2], after < before) == (before[:2], True), name  # software changes the probability only
    assert {control for row in hazards for control in row[6].split(", ")} == known


def test_the_software_is_that_of_the_lock_file() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    simulator = tomllib.loads((ROOT / "sim" / "pyproject.toml").read_text())["project"]["dependencies"]
    installed = [each for extra in ("daemon", "recording", "report", "authoring", "hardware") for each in extras[extra]]
    named = (*project["dependencies"], *installed, *simulator)
    wanted = {re.split(r"[\[><=]", each)[0] for each in named} - {"pcmrs"}
    locked = dict(re.findall(r"^([a-z0-9._-]+)==(\S+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE))

    listed = {row[0]: row[1] for row in rows_of(SAFETY.read_text(), "Third-party software")}

    assert listed == {name: locked[name] for name in wanted}
