"""`pcmrs console` says before anything is served why it cannot be served."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.unit.cli.command_line import run


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Uploads are stored below the cache, which must not be the user's here."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for loaded in [name for name in sys.modules if name.startswith("pcmrs.console.server")]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    ended = run("console")
    assert ended.exit_code == 4
    assert "uvicorn" in ended.stderr
    assert "install the extra console" in ended.stderr


def test_a_token_file_that_others_may_read_opens_no_page(tmp_path: Path, own_cache: Path) -> None:
    file = tmp_path / "token"
    file.write_text("a token of more than twenty characters\n")
    file.chmod(0o644)
    ended = run("console", "--token-file", str(file), "--port", "0")
    assert ended.exit_code == 4
    assert str(file) in ended.stderr
    assert "more than twenty" not in ended.output
    assert not own_cache.exists()


def test_an_identity_that_cannot_be_used_opens_no_page(tmp_path: Path, own_cache: Path) -> None:
    ended = run("console", "--identity", str(tmp_path / "nobody"), "--endpoint", "tls/127.0.0.1:1", "--port", "0")
    assert ended.exit_code == 4
    assert "nobody" in ended.stderr
    assert not own_cache.exists()


@pytest.mark.parametrize("port", ["-1", "65536", "http"])
def test_a_port_that_is_none_is_a_usage_error(port: str) -> None:
    ended = run("console", "--port", port)
    assert ended.exit_code == 2
    assert "--port" in ended.stderr


def test_a_folder_of_recordings_must_exist(tmp_path: Path) -> None:
    ended = run("console", "--recordings", str(tmp_path / "none"))
    assert ended.exit_code == 2
    assert "does not exist" in ended.stderr
