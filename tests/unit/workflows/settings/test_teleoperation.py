"""Settings of teleoperation that cannot be meant are refused."""

from __future__ import annotations

import pytest

from pcmrs.workflows.settings import TeleoperationSettings


def test_limits_of_delay_that_cannot_be_meant_are_refused() -> None:
    with pytest.raises(ValueError, match=r"slow_delay is 0\.6 s"):
        TeleoperationSettings(slow_delay=0.6)
