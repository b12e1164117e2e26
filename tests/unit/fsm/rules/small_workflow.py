"""A small sound workflow of three branches, which tests break in one place each."""

from __future__ import annotations

import pytest

from pcmrs.errors import BlueprintError
from pcmrs.fsm import parse_blueprint

SMALL = """
id = "small"
version = "1"

[branches.top]
level = 1
flags = ["ready", "finished"]
states = { "00" = "idle", "10" = "ready", "11" = "finished" }

[branches.top.operations.prepare]
from = ["*"]
to = "10"

[branches.top.operations.clear]
from = ["10", "11"]
to = "00"
unlatches = true

[branches.top.operations.reached]
from = ["10", "11"]
to = "11"
iio = true

[branches.top.operations.lost]
from = ["10", "11"]
to = "10"
iio = true

[branches.sub]
level = 2
states = { "0" = "open", "1" = "closed" }
emits = { "0" = "lost", "1" = "reached" }
parent = { branch = "top", start = "10", compatible = { "0" = ["00", "10"], "1" = ["11"] } }

[branches.sub.operations.finish]
from = ["0"]
to = "1"

[branches.sub.operations.reinit]
from = ["*"]
to = "0"
rio = true

[branches.side]
level = 1
states = { safe = "clear", near = "close", held = "stopped" }
revocations = [{ by = ["top"], from = ["near"], to = "safe" }]

[branches.side.operations.move]
from = ["safe"]
to = "near"
motion = "approach"
steps = ["follow"]
on_failure = "held"
on_unknown = "held"
requires = { top = ["11"] }

[branches.side.operations.withdraw]
from = ["near", "held"]
to = "safe"
"""

Fault = tuple[str, str, str, str, str]
"""Text that is replaced, by what, code of the finding, a word of its text, and text of the line it points to."""


def check_fault(fault: Fault) -> None:
    """Break the small workflow in one place, and check that the first finding names it."""
    old, new, code, fragment, line = fault
    assert old in SMALL
    text = SMALL.replace(old, new)
    with pytest.raises(BlueprintError) as caught:
        parse_blueprint(text.encode(), origin="small.toml")
    finding = caught.value.fields["findings"][0]
    assert finding.code == code
    assert fragment in finding.text
    assert line in text.split("\n")[finding.line - 1]
    assert str(finding).startswith(f"small.toml:{finding.line}:{finding.column}: {code}: ")
    assert str(finding) in caught.value.text
