"""Messages between a node and its simulated world."""

from __future__ import annotations

import pytest

from pcmrs.errors import (
    DeviceError,
    DeviceRefusedError,
    PayloadError,
    PcmrsError,
    UnknownOutcomeError,
)
from pcmrs_sim.process.wire import Failure

pytest.importorskip("mujoco")


@pytest.mark.parametrize("kind", [DeviceError, DeviceRefusedError, UnknownOutcomeError, PayloadError])
def test_an_error_crosses_the_link_with_its_code_text_and_fields(kind: type[PcmrsError]) -> None:
    error = Failure.of(kind("The arm moves.", code="moving", limit=0.5)).error()
    assert (type(error), error.code) == (kind, kind.code)
    assert (error.text, error.fields) == ("The arm moves.", {"code": "moving", "limit": 0.5})
