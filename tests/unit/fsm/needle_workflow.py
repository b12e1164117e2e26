"""A workflow of a needle whose sample is irreversible, with and without a confirmation of the insertion."""

from __future__ import annotations

from pcmrs.fsm import examine

NEEDLE = """
id = "needle"
version = "1"

[branches.needle]
states = { out = "outside", inside = "inside", sampled = "sample taken", done = "outside again" }

[branches.needle.operations]
insert = { from = ["out"], to = "inside", affects_patient = true, CONFIRM }
sample = { from = ["inside"], to = "sampled", affects_patient = true, irreversible = true }
withdraw = { from = ["inside", "sampled"], to = { inside = "out", sampled = "done" } }
again = { from = ["done"], to = "out", ALLOWS }

[branches.safety]
states = { watched = "Stop is heeded" }
operations.acknowledge = { from = ["*"], to = "watched", unlatches = true }
"""
ALLOWED = NEEDLE.replace("ALLOWS", 'allows_again = ["sample"]')
PLAIN = ALLOWED.replace(", CONFIRM", "")
CONFIRMED = ALLOWED.replace("CONFIRM", "confirm = true")


def found(text: str) -> list[tuple[str, tuple[str, ...] | None]]:
    return [(finding.code, finding.commands) for finding in examine(text.encode()).findings]
