"""Ports, extras, devices, streams, peers and certificates of a cell."""

from __future__ import annotations

import fcntl
import socket
from pathlib import Path

import pytest

from pcmrs.doctor import _surroundings as surroundings
from pcmrs.doctor._surroundings import certificates, devices, extras, is_running, motion, peers, ports, streams
from pcmrs.settings import Settings, read_settings
from tests.unit.doctor.machines import only


def settings(tmp_path: Path, *overrides: str) -> Settings:
    return read_settings(None, [f"cell.folder={tmp_path}", *overrides])


def test_a_port_that_is_taken_is_named_with_its_setting(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        wanted = settings(tmp_path, f"gateway.planner.port={port}", "console.enabled=false")
        found = [finding for finding in ports(wanted, running=False) if f"UDP port {port}" in finding.found]

    assert [finding.verdict for finding in found] == ["bad"]
    assert "gateway.planner.port" in found[0].remedy


def test_a_running_daemon_has_its_ports_and_devices(tmp_path: Path) -> None:
    wanted = settings(tmp_path)
    assert not is_running(wanted)
    with (tmp_path / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert is_running(wanted)
    assert not is_running(wanted)
    assert only(ports(wanted, running=True), "ports").verdict == "good"
    assert only(devices(wanted, running=True), "devices").verdict == "good"


def test_a_missing_extra_is_named_with_its_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surroundings, "_is_installed", lambda package: package not in ("mujoco", "nicegui"))
    found = {finding.found.partition(":")[0]: finding for finding in extras(settings(tmp_path))}

    assert found["sim"].verdict == "bad"
    assert "mujoco" in found["sim"].found
    assert found["console"].verdict == "warning"
    assert "docs/supply.md" in found["sim"].remedy


def test_absent_device_is_bad_and_a_cabinet_is_not_connected_to(tmp_path: Path) -> None:
    real = settings(
        tmp_path,
        "robot.driver=kst",
        "tracker.driver=ndi",
        f"ndi.device={tmp_path}/ttyUSB9",
        "pointer.driver=dwell",
        *(f"{device}.driver=none" for device in ("scene", "stimulator", "emg")),
    )
    found = {finding.found.partition(" ")[0]: finding for finding in devices(real, running=False)}

    assert found["ndi"].verdict == "bad"
    assert "ttyUSB9" in found["ndi"].found
    assert found["kst"].verdict == "good"  # nothing listens there: it was not dialled


def test_streams_that_other_machines_may_reach_are_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LSLAPICFG", raising=False)
    assert "not used" in only(streams(settings(tmp_path)), "streams").found
    used = settings(tmp_path, "emg.driver=lsl")
    assert only(streams(used), "streams").verdict == "good"
    monkeypatch.setenv("LSLAPICFG", "/etc/lab.cfg")
    assert only(streams(used), "streams").verdict == "warning"


def test_peers_whose_old_commands_would_be_taken_are_a_warning(tmp_path: Path) -> None:
    timed = ["gateway.peers.planner.key_file=/planner.key", "gateway.peers.planner.counter=unix_ns"]
    assert only(peers(settings(tmp_path, *timed)), "peers").verdict == "good"
    found = only(peers(settings(tmp_path, *timed, "gateway.peers.panel.key_file=/panel.key")), "peers")
    assert found.verdict == "warning"
    assert found.found.startswith("panel: a delayed command is accepted")


def test_an_identity_that_cannot_be_used_is_bad(tmp_path: Path) -> None:
    assert only(certificates(settings(tmp_path)), "certificates").verdict == "good"
    wrong = settings(tmp_path, f"access.identity={tmp_path}/none", f"access.register={tmp_path}/register.json")
    assert "not an identity" in only(certificates(wrong), "certificates").found


def test_cost_of_an_arm_that_moves_in_segments_is_named(tmp_path: Path) -> None:
    others = ["tracker.driver=none", "robot.driver=kst"]
    assert only(motion(settings(tmp_path)), "motion").verdict == "good"
    assert only(motion(settings(tmp_path, *others)), "motion").verdict == "good"
    found = only(motion(settings(tmp_path, *others, "kst.motion=ptp")), "motion")
    assert found.verdict == "warning"
    assert "0.5 s" in found.found
    assert 'kst.motion = "servo"' in found.remedy


def test_each_link_is_checked_at_its_own_address(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.2", 0))
        port = other.getsockname()[1]
        link = [f"gateway.mep.port={port}", "console.enabled=false"]
        free = list(ports(settings(tmp_path, *link), running=False))
        taken = list(ports(settings(tmp_path, *link, "gateway.mep.host=127.0.0.2"), running=False))
    assert not any(f"UDP port {port}" in finding.found for finding in free)
    assert any(f"UDP port {port} of 127.0.0.2" in finding.found for finding in taken)
