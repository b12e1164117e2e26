"""`pcmrs ros2` where it cannot do what it should: one readable line, and the exit status that it promises."""

from __future__ import annotations

import sys

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.testing.daemon import free_port


def test_a_missing_package_is_named_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for loaded in [name for name in sys.modules if name.startswith("pcmrs.ros2")]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, "pycdr2", None)
    done = CliRunner().invoke(main, ["ros2"])
    assert done.exit_code == 4
    assert "pycdr2" in done.stderr
    assert "install the extra ros2" in done.stderr


def test_missing_daemon_is_reported() -> None:
    done = CliRunner().invoke(main, ["ros2", "--set", f"cell.endpoint=tcp/127.0.0.1:{free_port()}"])
    assert done.exit_code == 3
    assert "No daemon answers" in done.stderr
