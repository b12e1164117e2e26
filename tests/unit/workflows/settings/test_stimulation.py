"""Settings of stimulation that cannot be meant are refused."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.workflows.settings import ProcedureSettings


def test_epochs_must_hold_what_is_looked_at() -> None:
    with pytest.raises(msgspec.ValidationError, match="epoch_before"):
        msgspec.convert({"stimulation": {"epoch_before": 0.05}}, ProcedureSettings)
