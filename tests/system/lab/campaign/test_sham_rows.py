"""Nine rows of the catalogue whose faults do not take place: each must find that by itself; nightly does it with all.

One more row, of the class order, is in `test_order_rows.py`, with the cell that it needs.
"""

from __future__ import annotations

from functools import partial

import pytest

from pcmrs_lab.campaign import datagrams
from pcmrs_lab.campaign.catalogue import catalogue
from pcmrs_lab.campaign.run import run_campaign
from pcmrs_lab.campaign.waiting import until_true

pytest.importorskip("mujoco")

NINE = ("O2", "O5", "O8", "O10", "C4", "A5", "A6", "A7", "B10")
"""Of the classes operator, clock, adversary and robot; all but the last share one daemon."""
SOON = 3.0
"""Seconds within which a row must see what nobody has sent; a fault that takes place may take longer."""


@pytest.mark.timeout(300)
def test_no_row_passes_without_its_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datagrams, "until_true", partial(until_true, within=SOON))
    report = run_campaign([catalogue()[row] for row in NINE], [1], is_sham=True)
    passed = [found.id for found in report.faults if found.outcome == "passed"]
    assert passed == list(NINE), [(found.id, found.response) for found in report.faults if found.outcome != "passed"]
