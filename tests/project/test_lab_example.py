"""The example of a lab's configuration is one: its keys exist, and its drivers take their tables."""

from __future__ import annotations

import tomllib

import msgspec
import pytest

from pcmrs.config import as_table
from pcmrs.devices.drivers.kst import KstSettings
from pcmrs.devices.drivers.lsl import LslSettings
from pcmrs.devices.drivers.ndi import NdiSettings
from pcmrs.devices.drivers.trigger import TriggerSettings
from pcmrs.settings import read_settings
from pcmrs.workflows.surface import read_surface
from tests import ROOT

LAB = ROOT / "examples" / "lab.toml"


def test_the_lab_has_real_devices_only() -> None:
    settings = read_settings(LAB)
    assert settings.drivers() == {"kst": ["robot"], "ndi": ["tracker"], "trigger": ["stimulator"], "lsl": ["emg"]}
    assert settings.pointer.driver == "dwell"
    assert settings.sim == {}
    assert settings.gateway.openigtlink.enabled
    assert read_surface(settings.procedure) is None, "a phantom's surface would be refused for a patient"


@pytest.mark.parametrize(
    ("table", "kind"), [("kst", KstSettings), ("ndi", NdiSettings), ("lsl", LslSettings), ("trigger", TriggerSettings)]
)
def test_every_driver_takes_its_table_as_it_is_written(table: str, kind: type[msgspec.Struct]) -> None:
    written = tomllib.loads(LAB.read_text())[table]
    taken = msgspec.to_builtins(msgspec.convert(as_table(read_settings(LAB))[table], kind))
    assert {key: taken[key] for key in written if not isinstance(written[key], dict)} == {
        key: value for key, value in written.items() if not isinstance(value, dict)
    }


def test_stimulator_and_electromyograph_mean_the_same_pulses() -> None:
    written = tomllib.loads(LAB.read_text())
    assert written["trigger"]["markers"] == written["lsl"]["markers"]
