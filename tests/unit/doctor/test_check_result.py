"""A finding says what was found, and what to do unless all is well."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.doctor._check_result import CheckResult, CheckVerdict, bad, good, warning


@pytest.mark.parametrize("verdict", ["good", "warning", "bad"])
def test_each_verdict_has_its_finding_and_all_keys_on_the_wire(verdict: CheckVerdict) -> None:
    words = ("disk", "0.1 GB free, the limit is 1 GB")
    found = {
        "good": good(*words),
        "warning": warning(*words, "Delete recordings."),
        "bad": bad(*words, "Delete recordings."),
    }[verdict]
    remedy = "" if verdict == "good" else "Delete recordings."
    assert msgspec.to_builtins(found) == {"check": "disk", "verdict": verdict, "found": words[1], "remedy": remedy}
    assert msgspec.json.decode(msgspec.json.encode(found), type=CheckResult) == found


def test_an_unknown_verdict_is_not_decoded() -> None:
    with pytest.raises(msgspec.ValidationError, match="verdict"):
        msgspec.json.decode(b'{"check": "a", "verdict": "fine", "found": ""}', type=CheckResult)
