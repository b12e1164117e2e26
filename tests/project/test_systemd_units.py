"""The units as systemd itself reads them: no line misspelt, little left open, and all three closed alike."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.request import HTTPCookieProcessor, build_opener

import pytest

from pcmrs.cli.running import EXIT_BAD_CONFIGURATION
from pcmrs.settings import CellSettings
from pcmrs.testing.daemon import free_port
from pcmrs.threads.realtime import Priority
from tests import ROOT

UNITS = ROOT / "deploy" / "systemd"
NAMES = ("pcmrs.service", "pcmrs-node@.service", "pcmrs-router.service")
MOST_EXPOSURE = 1.6
CLOSED = (
    "CapabilityBoundingSet",
    "NoNewPrivileges",
    "PrivateUsers",
    "ProtectSystem",
    "ProtectHome",
    "DynamicUser",
    "MemoryDenyWriteExecute",
    "SystemCallArchitectures",
)

WITHOUT_WRITE_EXECUTE = """
import ctypes, os, sys
PR_SET_MDWE, REFUSE_EXEC_GAIN = 65, 1
if ctypes.CDLL(None).prctl(PR_SET_MDWE, REFUSE_EXEC_GAIN, 0, 0, 0):
    sys.exit("this kernel has no MDWE")
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The shipped units and drop-ins, but with programs that exist on every machine."""
    copied = shutil.copytree(UNITS, tmp_path / "units")
    for unit in copied.glob("*.service"):
        unit.write_text(re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", unit.read_text(), flags=re.MULTILINE))
    return copied


def analyze(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, check=False)


@needs_systemd
@pytest.mark.parametrize("name", NAMES)
def test_systemd_has_nothing_to_say_of_a_unit(units: Path, name: str) -> None:
    verified = analyze("verify", "--man=no", "--recursive-errors=no", units / name)

    # It exits 0 on a misspelt key: only its words tell.
    assert (verified.stdout, verified.stderr, verified.returncode) == ("", "", 0)


@needs_systemd
def test_misspelt_line_in_a_drop_in_is_reported(units: Path) -> None:
    (units / "pcmrs.service.d" / "wrong.conf").write_text("[Service]\nIPAdressDeny=any\n")

    assert "IPAdressDeny" in analyze("verify", units / "pcmrs.service").stderr


def exposed(unit: Path) -> bool:
    """Whether systemd says that more of a unit lies open than it should."""
    judged = analyze("security", "--offline=true", f"--threshold={round(MOST_EXPOSURE * 10)}", unit)
    return judged.returncode != 0


@needs_systemd
@pytest.mark.parametrize("name", NAMES)
def test_little_is_left_open_with_all_drop_ins(units: Path, name: str) -> None:
    assert not exposed(units / name)


@needs_systemd
def test_a_unit_without_its_limits_would_be_found_out(units: Path) -> None:
    (units / "pcmrs.service.d" / "open.conf").write_text("[Service]\nSystemCallFilter=\nDynamicUser=no\n")

    assert exposed(units / "pcmrs.service")


@pytest.mark.parametrize("name", NAMES)
def test_every_unit_is_closed_alike(name: str) -> None:
    daemon, unit = (set((UNITS / each).read_text().splitlines()) for each in ("pcmrs.service", name))

    for key in CLOSED:
        assert {line for line in unit if line.startswith(f"{key}=")} == {
            line for line in daemon if line.startswith(f"{key}=")
        }


@pytest.mark.parametrize("name", NAMES)
def test_secret_is_a_credential_and_nothing_slows_the_deadman(name: str) -> None:
    unit = (UNITS / name).read_text()

    assert re.search(r"^LoadCredential=\S+\.key:/etc/pcmrs/", unit, flags=re.MULTILINE)
    assert not re.search(r"^(CPUQuota|MemoryHigh)=", unit, flags=re.MULTILINE)
    assert not re.search(r"^(SetCredential|Environment)=.*(KEY|SECRET)", unit, flags=re.MULTILINE)


def test_the_unit_fits_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = dict(re.findall(r"^(\w+)=(.*)$", (UNITS / "pcmrs.service").read_text(), re.MULTILINE))

    assert settings["RestartPreventExitStatus"] == str(EXIT_BAD_CONFIGURATION)
    monkeypatch.setenv("XDG_STATE_HOME", "/var/lib")  # what the unit sets: %S
    assert CellSettings().path().is_relative_to(Path("/var/lib") / settings["StateDirectory"])


def test_the_daemon_keeps_what_it_was_seen_to_fail_without() -> None:
    unit = (UNITS / "pcmrs.service").read_text()

    assert not re.search("^ProcSubset=pid", unit, re.MULTILINE)  # the boot_id of every row of the journal
    assert "AF_NETLINK" in unit  # which interface is loopback, for access control
    assert "SystemCallFilter=setpriority" in unit  # the recorder is nicer than the daemon
    assert "SystemCallFilter=seccomp" in unit  # what reads uploaded files confines itself


def test_the_node_may_read_the_load_that_it_reports() -> None:
    assert not re.search("^ProcSubset=pid", (UNITS / "pcmrs-node@.service").read_text(), re.MULTILINE)


OPENED_FOR_THE_BEAT = {"sched_setattr", "sched_setparam", "sched_setscheduler"}


@pytest.mark.parametrize("name", NAMES)
def test_only_whose_beats_count_may_take_the_real_time_policy(name: str) -> None:
    lines = (UNITS / name).read_text().splitlines()
    opened = {call for line in lines if line.startswith("SystemCallFilter=sched_") for call in line[17:].split()}
    realtime = {line for line in lines if line.startswith(("RestrictRealtime=", "LimitRTPRIO="))}

    if name == "pcmrs-router.service":
        assert (opened, realtime) == (set(), {"RestrictRealtime=yes"})
    else:
        assert (opened, realtime) == (OPENED_FOR_THE_BEAT, {"RestrictRealtime=no", "LimitRTPRIO=20"})
        assert max(Priority) <= 20
    assert not any(line.startswith("LimitRTTIME=") for line in lines)  # at its hard limit the kernel kills


@pytest.mark.nightly
def test_the_page_is_served_without_memory_to_write_and_execute() -> None:
    console = ["-m", "pcmrs.cli", "console", "--port", "0", "--json", "--endpoint", f"tcp/127.0.0.1:{free_port()}"]
    command = [sys.executable, "-c", WITHOUT_WRITE_EXECUTE, *console]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        if not line and "no MDWE" in (why := process.stderr.read()):
            pytest.skip(why)
        with build_opener(HTTPCookieProcessor()).open(json.loads(line)["url"], timeout=60.0) as page:
            assert page.status == 200
        process.terminate()
