"""What several tests of reports use."""

from __future__ import annotations

import pytest


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """`pcmrs report` draws none: that takes a second, and the text of most pages does not depend on them."""
    monkeypatch.setattr("pcmrs.report.figures.draw_figures", lambda _: {})
