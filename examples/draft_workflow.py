"""Draft a workflow, verify it, and repair it by the findings until it is sound.

The scripted drafter represents a language model: it sees only the output of `pcmrs fsm verify --json` for its draft.

    python examples/draft_workflow.py
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable
from typing import Any

import click
import tomli_w

MOST_ROUNDS = 10

DRAFT = """
id = "needle_biopsy"
version = "0.1.0"
title = "Needle biopsy, as first drafted"
goal = { needle = ["inserted"] }

[branches.registration]
flags = ["registered"]
states = { "0" = "not registered", "1" = "registered" }

[branches.registration.operations]
register = { from = ["0"], to = "1", steps = ["register_body"] }
import = { from = ["0"], to = "1", steps = ["take_registration"] }
clear = { from = ["1"], to = "0" }
moved = { from = ["0", "1"], to = { "0" = "0", "1" = "1" } }

[branches.needle]
level = 2
states = { away = "clear of the body", inserted = "at the target", stuck = "stopped on the way" }
emits = { "*" = "moved" }

[branches.needle.parent]
branch = "registration"
start = "1"
compatible = { away = ["0", "1"], inserted = ["1"], stuck = ["0", "1"] }

[branches.needle.operations]
insert = { from = ["away"], to = "inserted", steps = ["insert_needle"], on_failure = "stuck", on_unknown = "stuck" }

[[properties]]
id = "registered_while_inside"
never = { states = { registration = ["0"], needle = ["inserted", "stuck"] } }
"""

Table = dict[str, Any]
Finding = dict[str, Any]


def rename_operation(draft: Table, finding: Finding) -> str:
    """Rename an operation whose name is a reserved word of Python.

    Args:
        draft: Draft, which is changed.
        finding: Finding on it.
    """
    _, branch, _, word = finding["path"]
    operations = draft["branches"][branch]["operations"]
    operations[f"do_{word}"] = operations.pop(word)
    return f"{branch}.{word} is now {branch}.do_{word}"


def add_reinitiation(draft: Table, finding: Finding) -> str:
    """Add a re-initiation (Rule 1: every branch of level 2 or more has one).

    Args:
        draft: Draft, which is changed.
        finding: Finding on it.
    """
    name = finding["path"][1]
    branch = draft["branches"][name]
    start = next(iter(branch["states"]))
    branch["operations"]["reinit"] = {"from": ["*"], "to": start, "rio": True}
    return f"{name}.reinit leads to {start}"


def mark_as_signal(draft: Table, finding: Finding) -> str:
    """Mark the parent's operation as a signal (Rule 2: only the child calls it).

    Args:
        draft: Draft, which is changed.
        finding: Finding on it.
    """
    child = finding["path"][1]
    parent, called = draft["branches"][child]["parent"]["branch"], draft["branches"][child]["emits"]["*"]
    draft["branches"][parent]["operations"][called]["iio"] = True
    return f"{parent}.{called} is called by {child} only"


def forbid_last_command(draft: Table, finding: Finding) -> str:
    """Let the last command require other states, so that it no longer leads to a forbidden joint state.

    Args:
        draft: Draft, which is changed.
        finding: Finding on it.
    """
    branch, operation = finding["commands"][-1].partition(":")[0].split(".")
    forbidden = draft["properties"][int(finding["path"][1])]["never"]["states"]
    requires = {
        other: [state for state in draft["branches"][other]["states"] if state not in states]
        for other, states in forbidden.items()
        if other != branch
    }
    draft["branches"][branch]["operations"][operation]["requires"] = requires
    return f"{branch}.{operation} now needs {requires}"


REPAIRS: dict[str, Callable[[Table, Finding], str]] = {
    "reserved_name": rename_operation,
    "rule_1": add_reinitiation,
    "rule_2": mark_as_signal,
    "property_violated": forbid_last_command,
}


def verify(draft: Table) -> list[Finding]:
    """Return the findings on a draft; none if it is sound."""
    command = [sys.executable, "-m", "pcmrs.cli", "fsm", "verify", "--json", "-"]
    done = subprocess.run(command, input=tomli_w.dumps(draft), capture_output=True, text=True, check=False)
    findings: list[Finding] = json.loads(done.stdout)[0]["findings"] if done.returncode else []
    return findings


def main() -> int:
    """Draft, verify and repair; return the exit status."""
    draft = tomllib.loads(DRAFT)
    for number in range(1, MOST_ROUNDS + 1):
        findings = verify(draft)
        if not findings:
            click.echo(f"Round {number}: sound.\n")
            click.echo(tomli_w.dumps(draft))
            return 0
        finding = findings[0]
        click.echo(f"Round {number}: {finding['code']} at line {finding['line']}: {finding['text']}")
        if finding.get("commands"):
            click.echo(f"  Shown by: {', '.join(finding['commands'])}.")
        if finding["code"] not in REPAIRS:
            click.echo("  The drafter has no repair for this finding.")
            return 1
        click.echo(f"  Repaired: {REPAIRS[finding['code']](draft, finding)}.")
    click.echo(f"Not sound after {MOST_ROUNDS} rounds.")
    return 1


if __name__ == "__main__":
    sys.exit(main())
