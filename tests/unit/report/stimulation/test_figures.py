"""Figures of a session with stimulation show what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pcmrs.report.stimulation.figures import draw_figures, placements_figure, responses_figure, waveforms_figure
from tests.support.session_records import record, sparse_mesh

PICTURES = {"hotspot", "hunt", "responses", "waveforms", "placements"}


def test_pictures_are_files(tmp_path: Path) -> None:
    drawn = draw_figures(record(), sparse_mesh(), tmp_path)
    assert set(drawn) == PICTURES
    for path in drawn.values():
        assert path.read_bytes().lstrip().startswith((b"\x89PNG", b"<?xml"))


def test_pictures_show_every_pulse() -> None:
    figure = responses_figure(record())
    assert figure is not None
    drawn = [line for line in figure.axes[0].lines if line.get_label() != "least response"]
    assert sum(len(np.atleast_1d(line.get_xdata())) for line in drawn) == sum(
        pulse.mep is not None for pulse in record().pulses
    )
    placed, waves = placements_figure(record()), waveforms_figure(record())
    assert placed is not None
    assert waves is not None
    assert len(waves.axes) == 6
