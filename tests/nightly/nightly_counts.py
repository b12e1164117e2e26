"""How many of a part passed, failed and were skipped, from what its command left."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec

from tests.nightly.nightly_parts import Counted
from tests.support.skip_budget import beyond_budget


class Counts(msgspec.Struct, frozen=True, kw_only=True):
    """Results of a part.

    Attributes:
        skipped: Reason to how many.
        failures: Names of what failed.
    """

    passed: int
    failed: int
    skipped: dict[str, int]
    failures: list[str]


def counted(how: Counted, report: Path, output: str, code: int) -> Counts:
    """Counts of a part that has ended.

    Args:
        how: As the table says.
        report: Where pytest has written its report.
        output: What the command printed.
        code: Its exit code. Nothing is taken for passed where a command ended without a report.
    """
    try:
        if how == "pytest":
            found = _of_pytest(report)
        elif how == "exit":
            return _counts([] if code == 0 else [f"exit code {code}"], Counter(), 1 if code == 0 else 0)
        else:
            found = _OF_JSON[how](json.loads(output))
    except (OSError, ValueError, KeyError, TypeError, ElementTree.ParseError) as error:
        return _counts([f"no report: {type(error).__name__}, exit code {code}"], Counter(), 0)
    if code != 0 and not found.failures:
        return _counts([f"exit code {code}"], Counter(found.skipped), found.passed)
    return found


def _counts(failures: list[str], skipped: Counter[str], passed: int) -> Counts:
    return Counts(passed=passed, failed=len(failures), skipped=dict(sorted(skipped.items())), failures=failures)


def _of_pytest(report: Path) -> Counts:
    failures, skips, passed = list[str](), list[tuple[str, str]](), 0
    for case in ElementTree.parse(report).iter("testcase"):
        skip = case.find("skipped")
        name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
        if case.find("failure") is not None or case.find("error") is not None:
            failures.append(name)
        elif skip is not None and skip.get("type") == "pytest.xfail":  # it fails as its mark says
            passed += 1
        elif skip is not None:
            skips.append((name, _reason(skip)))
        else:
            passed += 1
    return _of_those_run(failures, skips, passed)


def _reason(skip: ElementTree.Element) -> str:
    """Reason of a skip; pytest reports that of a whole module only in the text."""
    message = skip.get("message", "")
    of_module = re.search(r"Skipped: (.+)['\"]\)$", (skip.text or "").strip())
    return of_module[1] if message == "collection skipped" and of_module else message


def _of_faults(said: dict[str, Any]) -> Counts:
    skips = [(each["id"], each["response"]) for each in said["faults"] if each["outcome"] == "not_run"]
    failures = [each["id"] for each in said["faults"] if each["outcome"] not in ("passed", "not_run")]
    return _of_those_run(failures, skips, sum(each["outcome"] == "passed" for each in said["faults"]))


def _of_those_run(failures: list[str], skips: list[tuple[str, str]], passed: int) -> Counts:
    """What a machine without the tools could not run has failed: a part is green only if all of it was run."""
    beyond = [f"skipped: {each}" for each in beyond_budget(skips)]
    return _counts([*failures, *beyond], Counter(reason for _, reason in skips), passed)


def _of_sessions(said: dict[str, Any]) -> Counts:
    broken = [f"seed {each['seed']}: {each['invariant']}" for each in said["broken"]]
    return _counts(broken, Counter(), said["sessions"] - len(broken))


def _of_mutants(said: dict[str, Any]) -> Counts:
    """Of mutants that need not all be caught, survivors are named as skipped while enough of the others are."""
    skipped = Counter(f"{each['name']}: {each['allowed']}" for each in said["mutants"] if each["allowed"])
    missed = [each for each in said["mutants"] if each["outcome"] != "caught" and not each["allowed"]]
    failures = [f"fails as it is: {test}" for test in said["unfit"]]
    if said["share"] >= said["wanted"]:
        skipped.update(f"{each['name']}: {each['outcome']}" for each in missed)
    else:
        failures += [f"{each['name']}: {each['outcome']}" for each in missed]
    return _counts(failures, skipped, said["caught"])


def _of_map(said: dict[str, Any]) -> Counts:
    lost = [f"{said['lost']} processes without data"] if said["lost"] else []
    return _counts([*said["failed"], *lost], Counter(), said["tests"])


def _of_uncovered(said: dict[str, Any]) -> Counts:
    """Guards with a side that was never run have failed, except those that have a reason."""
    named = [
        (f"{each['module']}:{each['function']}: {each['guard']} {each['side']}", each) for each in said["uncovered"]
    ]
    excused = Counter(f"{name}: {each['reason']}" for name, each in named if each["reason"])
    failures = [name for name, each in named if not each["reason"]]
    return _counts(failures, excused, said["guards"] - len(named))


_OF_JSON: dict[str, Callable[[dict[str, Any]], Counts]] = {
    "faults": _of_faults,
    "explore": _of_sessions,
    "mutants": _of_mutants,
    "map": _of_map,
    "uncovered": _of_uncovered,
}
