"""Settings of zones that cannot be meant are refused."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.workflows.settings import ProcedureSettings


@pytest.mark.parametrize("name", ["body", "tool", "sight_of_tool"])
def test_boxes_have_names_of_their_own(name: str) -> None:
    box = {"name": name, "pose": {}, "size": [0.1, 0.1, 0.1]}
    with pytest.raises(msgspec.ValidationError, match="a unique name"):
        msgspec.convert({"zones": {"boxes": [box]}}, ProcedureSettings)
