"""Lines of a schedule."""

from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs_sim.cli.lines import read_schedule


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("5.0 occlud coil", "line 1: There is no fault 'occlud'"),
        ("\nsoon e_stop", "line 2: write: seconds, then a fault"),
        ("5.0", "line 1: write: seconds, then a fault"),
        ("-5 e_stop", "line 1: the time is -5; it must be 0 s or later"),
        ("nan e_stop", "line 1: the time is nan"),
        ("1 cut_robot on now", "line 1: 'cut_robot on now' has 2 arguments"),
    ],
)
def test_a_schedule_names_the_line_that_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "faults.txt"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=complaint):
        read_schedule(file)


def test_a_schedule_is_in_the_order_of_time(tmp_path: Path) -> None:
    file = tmp_path / "faults.txt"
    file.write_text("5 e_stop off  # again\n1.5 e_stop on\n", encoding="utf-8")
    assert read_schedule(file) == [(1.5, "e_stop on"), (5.0, "e_stop off")]
