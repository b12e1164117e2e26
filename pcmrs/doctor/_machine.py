"""Checks of the machine: scheduling, kernel, limits of the process, and clock source.

Paths are those of proc(5) and sysfs(5), below a root that tests replace.
"""

from __future__ import annotations

import os
import platform
import resource
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from pcmrs.console.planning.confined import landlock_version
from pcmrs.doctor._check_result import CheckResult, bad, good, warning
from pcmrs.threads.realtime import Priority

ROOT: Final = Path("/")
FEWEST_FILES: Final = 1024
"""Open files that suffice for sockets, log, journal and shared memory of a daemon with its clients."""
FEWEST_PROCESSORS: Final = 2
"""Processors with which the daemon's loop and the one that moves the arm do not wait for each other."""
EXACT_CLOCKS: Final = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "xen")
"""Clock sources that are read with no call into the kernel, or with a fast one."""
UNLIMITED: Final = {-1: "unlimited", resource.RLIM_INFINITY: "unlimited"}

PERMIT: Final = (
    "Give LimitRTPRIO=20 in the unit (deploy/systemd has it), `rtprio: 20` to the container, or the line "
    "`USER - rtprio 20` to /etc/security/limits.d. Without it a busy machine delays heartbeats, and the arm is held."
)


def scheduling(root: Path = ROOT) -> Iterator[CheckResult]:
    """Check that threads may take the policy SCHED_RR, and the share that the kernel leaves to others."""
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    allowed = f"RLIMIT_RTPRIO is {UNLIMITED.get(limit, limit)}"
    refusal = _real_time_refusal()
    if refusal:
        yield warning("real-time policy", f"SCHED_RR is refused ({refusal}); {allowed}", PERMIT)
    else:
        yield good("real-time policy", f"SCHED_RR is permitted; {allowed}")
    runtime = _read(root / "proc/sys/kernel/sched_rt_runtime_us")
    if runtime == "-1":
        remedy = "`sysctl kernel.sched_rt_runtime_us=950000`, the kernel's default, throttles a runaway thread."
        yield warning("real-time share", "no time is left to other threads", remedy)
    elif runtime:
        period = _read(root / "proc/sys/kernel/sched_rt_period_us") or "1000000"
        yield good("real-time share", f"{int(runtime) / int(period):.0%} at most")


def _real_time_refusal() -> str:
    """Return why a thread may not take SCHED_RR with the highest priority that PCMRS gives; empty if it may.

    The thread that tries ends at once: this process stays as it was.
    """
    refused: list[str] = []

    def attempt() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(max(Priority)))
        except OSError as error:
            refused.append(error.strerror or str(error))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return "".join(refused)


def kernel(root: Path = ROOT, version: str = "") -> Iterator[CheckResult]:
    """Check that the kernel can be preempted, and counts the time that a thread waits.

    Args:
        root: Root of the file system.
        version: Version of the kernel; by default that of this one.
    """
    version = version or platform.version()
    shown = f"Linux {platform.release()}, {version}"
    if "PREEMPT" in version or _read(root / "sys/kernel/realtime") == "1":
        yield good("kernel", shown)
    else:
        remedy = "Use a kernel with PREEMPT_DYNAMIC, as most distributions have, or PREEMPT_RT (linux-image-rt-amd64)."
        yield warning("kernel", f"{shown}: not preemptible", remedy)
    if not (root / "proc/self/schedstat").exists():
        remedy = "Use a kernel with CONFIG_SCHED_INFO: without it a hold cannot name a busy machine as its cause."
        yield warning("scheduling figures", "the kernel has no /proc/PID/schedstat", remedy)


def limits(root: Path = ROOT) -> Iterator[CheckResult]:
    """Check the limits of this process and of its control group; a service or container has its own."""
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if files in UNLIMITED or files >= FEWEST_FILES:
        yield good("open files", f"{UNLIMITED.get(files, files)}")
    else:
        yield bad("open files", f"{files}; {FEWEST_FILES} are needed", f"`ulimit -n {FEWEST_FILES}`, or LimitNOFILE=.")
    runaway = resource.getrlimit(resource.RLIMIT_RTTIME)
    if any(each not in UNLIMITED for each in runaway):
        text = f"RLIMIT_RTTIME is {runaway[0]} and {runaway[1]} µs: at the second the kernel kills the process"
        yield bad(
            "real-time limit", text, "Remove LimitRTTIME= from the unit, or `rttime` from /etc/security/limits.d."
        )
    yield _processors()
    yield from _group(root)


def _processors() -> CheckResult:
    many = len(os.sched_getaffinity(0))
    load = os.getloadavg()[0]
    shown = f"{many}, of which other programs use {load:.1f}"
    if many < FEWEST_PROCESSORS:
        return warning("processors", f"{shown}; {FEWEST_PROCESSORS} are recommended", "Give the cell more processors.")
    if load > many:
        return warning("processors", shown, "Reduce the load of the machine: `top` shows its programs.")
    return good("processors", shown)


def _group(root: Path) -> Iterator[CheckResult]:
    """Check for a quota of processor time: it stops all threads of a group, even those with a real-time policy."""
    group = _read(root / "proc/self/cgroup").partition("0::/")[2].splitlines()[:1]
    folder = root / "sys/fs/cgroup" / (group[0] if group else "")
    quota, _, period = (_read(folder / "cpu.max") or "max 0").partition(" ")
    if quota != "max":
        text = f"a quota of {int(quota) / int(period):.2g} processors: at its end, all threads wait for the next period"
        yield warning("control group", text, "Remove CPUQuota= from the unit, or --cpus from the container.")
    else:
        yield good("control group", "no quota of processor time")


def clock_source(root: Path = ROOT) -> Iterator[CheckResult]:
    """Check the kernel's source of time."""
    source = _read(root / "sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source in EXACT_CLOCKS or not source:
        yield good("clock source", source or "not reported by this kernel")
    else:
        available = _read(root / "sys/devices/system/clocksource/clocksource0/available_clocksource")
        remedy = "Boot with clocksource=tsc if the machine's is stable (`dmesg | grep -i tsc` says why it was dropped)."
        yield warning("clock source", f"{source} of {available}: every reading of the time is slow", remedy)


def uploads(version: int | None = None) -> Iterator[CheckResult]:
    """Check that the process that reads uploaded files is confined by both layers.

    Args:
        version: Version of the kernel's Landlock; by default that of this one.
    """
    version = landlock_version() if version is None else version
    if version:
        yield good("uploads", f"read in a process that a filter of system calls and Landlock {version} confine")
    else:
        remedy = "Use a kernel with CONFIG_SECURITY_LANDLOCK, and `landlock` among those of /sys/kernel/security/lsm."
        yield warning("uploads", "there is no Landlock: only the filter of system calls confines their reader", remedy)


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
