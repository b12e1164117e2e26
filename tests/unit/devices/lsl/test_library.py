"""The library of Lab Streaming Layer: configured by us unless the lab does it, and named if it is missing."""

from __future__ import annotations

import configparser
import sys
from pathlib import Path
from types import ModuleType

import pytest
from structlog.testing import capture_logs

from pcmrs.devices.lsl import library
from pcmrs.devices.lsl.library import lab_configuration, load_lsl
from pcmrs.errors import ConfigurationError


class Module(ModuleType):
    """As much of ``pylsl`` as loading it uses."""

    def __init__(self) -> None:
        super().__init__("pylsl")
        self.configured: list[str] = []

    def set_config_content(self, content: str) -> None:
        self.configured.append(content)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Module:
    """A fresh process on a machine without files of the lab."""
    module = Module()
    monkeypatch.setitem(sys.modules, "pylsl", module)
    monkeypatch.setattr(library, "load_lsl", load_lsl.__wrapped__)
    monkeypatch.setattr(library, "CONFIGURATION_FILES", (str(tmp_path / "lsl_api.cfg"), "~/lsl_api/lsl_api.cfg"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("LSLAPICFG", raising=False)
    return module


def test_streams_are_offered_and_searched_on_this_machine_only(module: Module) -> None:
    assert library.load_lsl() is module
    (content,) = module.configured
    own = configparser.ConfigParser()
    own.read_string(content)
    assert own["multicast"]["ResolveScope"] == "machine"
    assert own["multicast"]["ListenAddress"] == "127.0.0.1"
    assert own["lab"]["KnownPeers"] == "{127.0.0.1}"


@pytest.mark.parametrize("how", ["variable", "here", "home"])
def test_the_labs_own_configuration_is_kept_and_reported(
    module: Module, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, how: str
) -> None:
    if how == "variable":
        monkeypatch.setenv("LSLAPICFG", file := "/lab/lsl.cfg")
    else:
        (tmp_path / "lsl_api").mkdir()
        (tmp_path / ("lsl_api.cfg" if how == "here" else "lsl_api/lsl_api.cfg")).touch()
        file = str(tmp_path / "lsl_api.cfg") if how == "here" else "~/lsl_api/lsl_api.cfg"
    with capture_logs() as logs:
        library.load_lsl()
    assert module.configured == []
    assert [(entry["event"], entry["file"]) for entry in logs] == [("lsl_configured_by_lab", file)]
    assert lab_configuration() == file


def test_a_missing_library_is_named_with_the_remedy(module: Module, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(ConfigurationError, match="install the extra hardware"):
        library.load_lsl()
