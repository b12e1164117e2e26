"""Every container is closed, and none but the router is dialled."""

import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from pcmrs.devices.ndi.tools import placeholder
from pcmrs.settings import read_settings
from tests import ROOT

FOLDER = ROOT / "deploy" / "container"
SERVICES: dict[str, Any] = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]


@pytest.mark.parametrize("name", SERVICES)
def test_a_container_can_write_nothing_and_become_nobody_else(name: str) -> None:
    service = SERVICES[name]

    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["user"].split(":")[0] not in ("", "0", "root")
    assert not {"privileged", "cap_add", "devices", "network_mode", "pid"} & service.keys()
    assert service["pids_limit"]
    assert service["memswap_limit"] == service["mem_limit"]  # it does not swap


@pytest.mark.parametrize("name", SERVICES)
def test_secrets_and_settings_are_mounted_for_reading_only(name: str) -> None:
    for mount in SERVICES[name].get("volumes", []):
        assert mount.endswith(":ro") or not mount.startswith("."), mount


def test_only_the_cell_may_take_the_real_time_policy() -> None:
    assert [name for name, service in SERVICES.items() if "rtprio" in service["ulimits"]] == ["cell"]
    assert SERVICES["cell"]["ulimits"].items() > SERVICES["sim"]["ulimits"].items()


def test_only_the_router_has_ports_and_devices_have_own_network() -> None:
    assert [name for name, service in SERVICES.items() if "ports" in service] == ["router"]
    assert SERVICES["sim"]["networks"] == ["devices"]


def test_serving_containers_have_health_checks() -> None:
    assert SERVICES["cell"]["healthcheck"]["test"] == ["CMD", "pcmrs", "health"]
    assert SERVICES["router"]["healthcheck"]["test"]


def test_every_program_that_is_started_is_one_of_ours() -> None:
    for service in SERVICES.values():
        program, *words = service["command"]
        assert program in ("pcmrs-router", "pcmrs-sim", "pcmrs-serve")
        assert all(isinstance(word, str) for word in words), words


def test_the_cell_s_settings_are_read(tmp_path: Path) -> None:
    shutil.copy(FOLDER / "cell.toml", tmp_path)

    settings = read_settings(tmp_path / "cell.toml", ["access.identity=/identity", "access.register=/register.json"])

    assert set(settings.drivers()) == {"kst", "ndi"}
    assert settings.access.routers == ("tls/router:7449",)


def test_cell_tools_are_mounted_and_known_to_the_virtual_tracker() -> None:
    tools = tomllib.loads((FOLDER / "cell.toml").read_text())["ndi"]["tools"]

    assert "./tools:/etc/pcmrs/tools:ro" in SERVICES["cell"]["volumes"]
    assert {"coil", "body_ref", "pointer"} <= tools.keys()
    for body, file in tools.items():
        assert (FOLDER / Path(file).relative_to("/etc/pcmrs")).read_bytes() == placeholder(body)
