"""What `pcmrs doctor` finds in the kernel, and what to do about it."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from pcmrs.doctor._machine import clock_source, kernel, limits, scheduling, uploads
from tests.unit.doctor.machines import only


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


def test_a_kernel_without_landlock_is_a_warning() -> None:
    assert only(uploads(3), "uploads").verdict == "good"
    assert only(uploads(0), "uploads").verdict == "warning"
