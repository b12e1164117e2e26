"""The page of evidence is up to date, and a document that cites a test says whether that is nightly only."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests import ROOT, TESTS
from tests.nightly import make_evidence
from tests.nightly.make_evidence import PAGE, page, parts_of
from tests.nightly.nightly_parts import parts
from tests.nightly.nightly_results import Result, this_machine
from tests.support.documents import SOURCES, cited, documents, promises


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text() == page(), "make evidence"


@pytest.mark.parametrize("document", documents(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_document_says_which_tests_make_test_does_not_run(document: Path, collected: list[Any]) -> None:
    """Of tests whose files this run has collected: in `make test` all. Those marks are `(nightly)` and `(browser)`."""
    instances = defaultdict(set)
    for each in collected:
        instances[each.file, each.name].add(each.only)
    files = {each.file for each in collected}

    for each in cited(document.read_text()):
        assert (TESTS / each.file).is_file(), each
        if each.file in files:
            assert instances[each.file, each.test], f"{each.file}::{each.test} does not exist."
            assert each.only == min(instances[each.file, each.test]), each


@pytest.mark.parametrize("mark", ["", "nightly", "browser"])
def test_a_mark_is_read_where_it_belongs(mark: str) -> None:
    text = "`unit/a/test_a.py::test_first`" + (f" ({mark})" if mark else " (in a room)")

    assert [each.only for each in cited(f"{text}, `unit/b.py::test_second` (nightly)")] == [mark, "nightly"]


def test_every_promise_has_its_own_id_and_a_proof() -> None:
    found = [promise for source in SOURCES for promise in promises(source)]

    assert len({promise.id for promise in found}) == len(found)
    assert [promise.id for promise in found if not (promise.tests or promise.rows)] == []


def test_the_parts_that_prove_a_promise_are_named() -> None:
    stop = next(promise for source in SOURCES for promise in promises(source) if promise.id == "SR2")

    found = parts_of(stop)

    assert {"faults-operator", "faults-adversary", "sham-1", "explore-ratms"} <= set(found)
    assert "faults-sensor" not in found
    promise = promises(SOURCES[0])[0]._replace(rows=["N9"])
    assert {"faults-network", "faults-n9"} <= set(parts_of(promise)), "a row with more seeds is in two parts"


def test_parts_that_failed_or_were_never_run_are_on_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    result = Result(
        part="faults-operator",
        commit="1" * 40,
        machine=this_machine(),
        begun="2026-01-02T03:04:05+00:00",
        seconds=90.0,
        passed=12,
        failed=1,
        skipped={"C1: no C compiler": 1},
        failures=["O11"],
        exit_code=1,
    )
    green = msgspec.structs.replace(result, part="explore-ratms", failed=0, failures=[], exit_code=0)
    monkeypatch.setattr(make_evidence, "published", lambda: [result, green])

    text = page()

    assert f"2 of {len(parts())} parts were run" in text
    assert "| `faults-operator` | **red** | 1111111 | 2026-01-02 03:04 | 12 | 1 | 1 | 1.5 | 1 |" in text
    assert "| `explore-ratms` | green |" in text
    assert "| `sham-1` | not run |" in text
    assert "- faults-operator: failed: `O11`" in text
    assert "- faults-operator: skipped 1: C1: no C compiler" in text
    (line,) = (line for line in text.splitlines() if line.startswith("| SR2 |"))
    assert "**red**: faults-operator" in line
    assert "green: explore-ratms" in line
