"""What of a configuration opens a cell, and what is refused before anything is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.bus import BusSettings
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, ConfigurationError
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority
from pcmrs.settings import read_settings


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    now = SystemClock().wall()
    authority = Authority.init(tmp_path / "pki", "lab", now)
    authority.issue("daemon", "c1", now, cells=("lab/cell1",), into=tmp_path)
    authority.issue("daemon", "c2", now, cells=("lab/cell2",), into=tmp_path)
    authority.issue("daemon", "c3", now, cells=EVERY_CELL, into=tmp_path)
    authority.revoke("c3", now)
    authority.issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path)
    authority.issue("operator", "old", now - 10 * 86400.0, days=7.0, cells=EVERY_CELL, into=tmp_path)
    return tmp_path


def settings_of(lab: Path, identity: str, *more: str) -> BusSettings:
    access = (f"access.identity={lab / identity}", f"access.register={lab / 'pki/register.json'}")
    return read_settings(None, [*access, *more]).bus("router")


def test_a_cell_is_closed_unless_it_has_an_identity() -> None:
    settings = read_settings()
    assert not settings.access.is_open
    values = settings.bus("router").zenoh_config()
    assert values["listen/endpoints"] == ["tcp/127.0.0.1:7447"]
    assert values["connect/endpoints"] == []
    assert "access_control" not in values


def test_an_open_cell_denies_what_nobody_has_a_right_to(lab: Path) -> None:
    more = ('access.listen=["tls/0.0.0.0:7448"]', 'access.routers=["tls/router:7449"]')
    values = settings_of(lab, "c1", *more).zenoh_config()
    assert values["listen/endpoints"] == ["tcp/127.0.0.1:7447", "tls/0.0.0.0:7448"]
    assert values["connect/endpoints"] == ["tls/router:7449"]
    assert values["access_control"]["default_permission"] == "deny"
    assert values["transport/link/tls"]["enable_mtls"]
    names = [each["id"] for each in values["access_control"]["subjects"]]
    assert names == ["c1", "c2", "anna", "old", "local"], "who is revoked has no rights"


@pytest.mark.parametrize(
    ("identity", "why"),
    [
        ("c2", "may serve lab/cell2, not lab/cell1"),
        ("c3", "is revoked"),
        ("anna", "has the role operator, not daemon"),
        ("nobody", "is not an identity"),
    ],
)
def test_a_daemon_runs_as_what_the_register_says_only(lab: Path, identity: str, why: str) -> None:
    with pytest.raises(ConfigurationError, match=why):
        settings_of(lab, identity)


def test_a_register_without_the_daemon_is_an_old_one(lab: Path) -> None:
    (lab / "pki/register.json").write_text("[]")
    with pytest.raises(ConfigurationError, match="copy the authority's present one"):
        settings_of(lab, "c1")


@pytest.mark.parametrize("table", ["listen", "routers"])
def test_a_cell_is_not_opened_without_certificates(lab: Path, table: str) -> None:
    with pytest.raises(ConfigurationError, match=r"access\.identity"):
        read_settings(None, [f'access.{table}=["tls/0.0.0.0:7448"]'])
    with pytest.raises(ConfigurationError, match="it must begin with tls/"):
        settings_of(lab, "c1", f'access.{table}=["tcp/0.0.0.0:7448"]').zenoh_config()


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.7", "[::]", "cell.example.org"])
@pytest.mark.parametrize("mode", ["router", "client"])
def test_a_plain_endpoint_is_this_machines_own(host: str, mode: Any) -> None:
    with pytest.raises(ConfigurationError, match="without certificates"):
        BusSettings(mode=mode, endpoint=f"tcp/{host}:7447").zenoh_config()
    for own in ("127.0.0.1", "[::1]", "localhost"):
        BusSettings(mode=mode, endpoint=f"tcp/{own}:7447").zenoh_config()


def test_nobody_dials_another_machine_without_an_identity() -> None:
    with pytest.raises(ConfigurationError, match="--identity"):
        BusSettings(endpoint="tls/router:7449").zenoh_config()


@pytest.mark.parametrize(
    ("name", "why"), [("c2", "foreign"), ("c3", "revoked"), ("old", "expired"), ("nobody", "unknown")]
)
def test_user_without_access_has_no_role(lab: Path, name: str, why: str) -> None:
    settings = settings_of(lab, "c1")
    with pytest.raises(AccessError) as refused:
        settings.role_of(name)
    assert refused.value.fields == {"user": name, "why": why}
    assert (settings.role_of("anna"), settings.role_of("local")) == ("operator", "operator")


@pytest.mark.parametrize("peer", ["anna", "Anna", "c2", "c3"])
def test_peer_with_the_name_of_a_member_is_refused(lab: Path, peer: str) -> None:
    """Also of a revoked one: lease and journal know users by their names only."""
    of_peer = f"gateway.peers.{peer}.key_file={lab / 'peer.key'}"
    with pytest.raises(ConfigurationError, match=r"would count as one user\. Choose another name") as refused:
        settings_of(lab, "c1", of_peer)
    assert refused.value.fields == {"peer": peer}
    assert settings_of(lab, "c1", of_peer.replace(peer, "panel", 1)).members


def test_every_fault_has_its_line_and_what_could_be_meant(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(
        "[procedure.placement]\nstandof = 0.07\nclearance = 280\nsettle_time = 'long'\n[robt]\nmodel = 'iiwa7'\n"
    )
    with pytest.raises(ConfigurationError) as refused:
        read_settings(file, ["procedure.zones.box_margin=20"])
    first, *lines = refused.value.text.splitlines()
    assert first == "The configuration is wrong:"
    assert sorted(lines) == sorted(
        [
            f"{file}:2:1: procedure.placement.standof: unknown key; did you mean 'standoff'?",
            f"{file}:3:1: procedure.placement.clearance is 280 m: expected `float` <= 5.0; did you mean 0.28 (280 mm)?",
            f"{file}:4:1: procedure.placement.settle_time is 'long': expected `float`, got `str`.",
            f"{file}:5:2: robt: unknown key; did you mean 'robot'?",
            "--set procedure.zones.box_margin: procedure.zones.box_margin is 20 m: expected `float` <= 5.0; "
            "did you mean 0.02 (20 mm)?",
        ]
    )
