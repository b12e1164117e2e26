"""The line under the plan says what the daemon would say."""

from __future__ import annotations

from pcmrs.console.planning._checking import BAD, GOOD, OPEN, describe_results
from pcmrs.console.texts import Texts
from pcmrs.messages import DryRunResult, Reason


def test_the_line_says_what_the_daemon_would_say() -> None:
    texts = Texts("en")
    good = DryRunResult(result={"tre": 0.0012})
    bad = DryRunResult(reason=Reason(code="unreachable", text="Too far."))
    open_ = DryRunResult(undecided=["Whether the arm reaches it is not known before a registration."])
    assert describe_results([good], texts)[1] == GOOD
    assert "1.20 mm" in describe_results([good], texts)[0]
    assert describe_results([DryRunResult()], texts)[1] == GOOD
    assert "eachable" not in describe_results([DryRunResult()], texts)[0], "nobody has looked at its reach"
    assert describe_results([open_], texts) == (f"? {open_.undecided[0]}", OPEN)
    assert describe_results([bad], texts) == ("✗ Too far.", BAD)
    assert describe_results([DryRunResult(), good, bad], texts) == ("✗ Point 2: Too far.", BAD)
