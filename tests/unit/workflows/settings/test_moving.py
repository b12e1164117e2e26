"""Settings of motions that cannot be meant are refused."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.workflows.settings import AlignmentSettings, ContactSettings, PlacementSettings


def test_settings_that_would_flicker_are_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match="must not be smaller"):
        msgspec.convert({"on_mm": 2.0}, AlignmentSettings)


def test_confirming_must_lead_towards_the_body() -> None:
    assert PlacementSettings(standoff=0.05, confirm_offset=0.049).confirm_offset == 0.049
    with pytest.raises(ValueError, match=r"confirm_offset is 0\.05 m, but standoff is only 0\.05 m"):
        PlacementSettings(standoff=0.05, confirm_offset=0.05)


@pytest.mark.parametrize("force", [0.9, 5.1, float("nan")])
def test_a_configured_press_is_gentle(force: float) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"force": force}, ContactSettings)
