"""Stop finds a descriptor: the daemon raises its limit as far as it may."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pcmrs.descriptors import NEEDED

PROGRAM = """
import resource
from pcmrs.descriptors import reserve
resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))
reserve()
print(*resource.getrlimit(resource.RLIMIT_NOFILE))
"""


@pytest.mark.parametrize(
    ("soft", "hard", "raised"),
    [(256, NEEDED + 1, NEEDED), (256, 512, 512), (NEEDED + 1, NEEDED + 1, NEEDED + 1)],
)
def test_the_limit_is_raised_to_what_is_needed_where_it_may_be(soft: int, hard: int, raised: int) -> None:
    program = PROGRAM.format(soft=soft, hard=hard)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(raised), str(hard)]
