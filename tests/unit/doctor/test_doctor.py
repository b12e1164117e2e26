"""What `pcmrs doctor` finds on a machine, and that every line that is not good says what to do."""

from __future__ import annotations

import fcntl
import os
import resource
import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.cli.doctor import doctor
from pcmrs.doctor import CheckResult, Examination, surroundings
from pcmrs.doctor.disk import assess_times, disk, free_space
from pcmrs.doctor.machine import clock_source, kernel, limits, scheduling
from pcmrs.doctor.surroundings import certificates, devices, extras, is_running, peers, ports, streams
from pcmrs.settings import Settings, read_settings


def only(findings: Iterator[CheckResult], check: str) -> CheckResult:
    (found,) = [finding for finding in findings if finding.check == check]
    assert bool(found.remedy) == (found.verdict != "good")
    return found


def settings(tmp_path: Path, *overrides: str) -> Settings:
    return read_settings(None, [f"cell.folder={tmp_path}", *overrides])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A machine on which all is well."""
    for name, content in {
        "proc/sys/kernel/sched_rt_runtime_us": "950000",
        "proc/sys/kernel/sched_rt_period_us": "1000000",
        "proc/self/schedstat": "1 2 3",
        "proc/self/cgroup": "0::/cell\n",
        "sys/fs/cgroup/cell/cpu.max": "max 100000",
        "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
        "sys/devices/system/clocksource/clocksource0/available_clocksource": "tsc hpet",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    return tmp_path


def test_forbidden_real_time_policy_is_reported_with_its_remedy(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    before = os.sched_getscheduler(0)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    found = only(scheduling(root), "real-time policy")

    assert found.verdict == "warning"
    assert "Operation not permitted" in found.found
    assert "LimitRTPRIO" in found.remedy
    assert os.sched_getscheduler(0) == before


def test_looking_at_the_policy_leaves_this_process_as_it_was(root: Path) -> None:
    before = os.sched_getscheduler(0)
    assert only(scheduling(root), "real-time share").found == "95% at most"
    assert os.sched_getscheduler(0) == before


def test_unlimited_real_time_share_is_a_warning(root: Path) -> None:
    (root / "proc/sys/kernel/sched_rt_runtime_us").write_text("-1")
    assert only(scheduling(root), "real-time share").verdict == "warning"


@pytest.mark.parametrize(("version", "verdict"), [("#1 SMP PREEMPT_DYNAMIC", "good"), ("#1 SMP", "warning")])
def test_kernel_without_preemption_is_a_warning(root: Path, version: str, verdict: str) -> None:
    assert only(kernel(root, version), "kernel").verdict == verdict


def test_kernel_without_scheduling_figures_is_a_warning(root: Path) -> None:
    (root / "proc/self/schedstat").unlink()
    assert only(kernel(root), "scheduling figures").verdict == "warning"


def test_processor_quota_is_reported(root: Path) -> None:
    assert only(limits(root), "control group").verdict == "good"
    (root / "sys/fs/cgroup/cell/cpu.max").write_text("50000 100000")
    assert "0.5 processors" in only(limits(root), "control group").found


def test_a_limit_at_which_the_kernel_kills_is_bad(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = resource.getrlimit
    monkeypatch.setattr(
        resource,
        "getrlimit",
        lambda which: (200_000, 400_000) if which == resource.RLIMIT_RTTIME else real(which),
    )
    assert only(limits(root), "real-time limit").verdict == "bad"


def test_too_few_open_files_are_bad(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _which: (256, 4096))
    assert only(limits(root), "open files").verdict == "bad"


def test_slow_clock_source_is_reported(root: Path) -> None:
    assert only(clock_source(root), "clock source").verdict == "good"
    (root / "sys/devices/system/clocksource/clocksource0/current_clocksource").write_text("hpet")
    assert "hpet of tsc hpet" in only(clock_source(root), "clock source").found


@pytest.mark.parametrize(("kind", "verdict"), [("ext4", "good"), ("tmpfs", "warning"), ("nfs4", "bad")])
def test_journal_disk_is_judged_by_its_file_system(tmp_path: Path, kind: str, verdict: str) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/root / ext4 rw 0 0\nthere {tmp_path.resolve()} {kind} rw 0 0\n")
    folder = tmp_path / "not" / "yet" / "made"

    assert only(disk(folder, mounts), "journal's disk").verdict == verdict
    assert not folder.parent.parent.exists()


@pytest.mark.parametrize(("longest", "verdict"), [(0.004, "good"), (0.2, "warning"), (1.5, "bad")])
def test_the_time_of_fsync_is_judged_by_the_longest(longest: float, verdict: str) -> None:
    found = assess_times([0.002] * 49 + [longest])
    assert found.verdict == verdict
    assert f"{longest * 1e3:.2g} ms" in found.found


@pytest.mark.parametrize(
    ("warn", "floor", "verdict"), [(0.0, 0.0, "good"), (1e18, 0.0, "warning"), (1e18, 1e18, "bad")]
)
def test_free_space_is_compared_with_the_daemon_s_limits(
    tmp_path: Path, warn: float, floor: float, verdict: str
) -> None:
    assert only(free_space(tmp_path, warn, floor), "free space").verdict == verdict


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


@pytest.mark.parametrize(("floor", "status"), [("0", (0, 1)), ("1e12", (2,))])
def test_the_status_tells_the_worst_and_every_line_what_to_do(
    tmp_path: Path, floor: str, status: tuple[int, ...]
) -> None:
    free = ["gateway.planner.port=0", "gateway.robot.port=0", "gateway.visualization.port=0", "gateway.mep.port=0"]
    free += ["gateway.tcp_port=0", "console.enabled=false", "cell.endpoint=tcp/127.0.0.1:0"]
    words = [f"--set={each}" for each in (f"cell.folder={tmp_path}", f"journal.least_free_mb={floor}", *free)]

    told = CliRunner().invoke(doctor, [*words, "--json"])
    shown = CliRunner().invoke(doctor, words)

    found = msgspec.json.decode(told.stdout, type=Examination)
    assert told.exit_code in status
    assert found.verdict == ("good", "warning", "bad")[told.exit_code]
    assert all(bool(each.remedy) == (each.verdict != "good") for each in found.findings)
    assert {"real-time policy", "kernel", "time of fsync", "free space", "certificates"} <= {
        each.check for each in found.findings
    }
    assert "free space" in shown.stdout
    assert list(tmp_path.iterdir()) == []  # it only looks
