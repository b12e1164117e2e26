"""Faults of network, processes, storage, clock and adversaries, injected into real daemons."""

from __future__ import annotations

import pytest

from pcmrs_lab.campaign.catalogue import choose
from pcmrs_lab.campaign.run import run_campaign
from tests.system.lab.campaign.answered import check_answered

QUICK = ("N5", "A7")
"""On one daemon, in seconds."""


@pytest.mark.nightly
def test_datagrams_at_the_socket_do_no_harm() -> None:
    check_answered((run_campaign(choose((), QUICK), [0])).faults)
