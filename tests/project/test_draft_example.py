"""The scripted drafter of `examples`: a program mends a workflow by the findings alone."""

from __future__ import annotations

import re
import subprocess
import sys

from pcmrs.fsm import parse_blueprint
from tests import ROOT

EXAMPLE = ROOT / "examples" / "draft_workflow.py"


def test_the_drafter_ends_with_a_sound_workflow() -> None:
    done = subprocess.run([sys.executable, str(EXAMPLE)], capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    rounds, _, draft = done.stdout.partition(": sound.\n\n")
    codes = re.findall(r"^Round \d+: (\w+) at line \d+", rounds, re.MULTILINE)
    assert codes[:3] == ["reserved_name", "rule_1", "rule_2"]
    assert set(codes[3:]) == {"property_violated"}
    assert rounds.count("Repaired") == len(codes)
    blueprint = parse_blueprint(draft.encode())
    assert blueprint.branches["registration"].operations["clear"].requires == {"needle": ["away"]}
