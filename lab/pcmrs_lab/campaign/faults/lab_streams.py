"""A stream of Lab Streaming Layer from another machine on the cell's network, under the name of the cell's stream."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from pcmrs.devices.lsl.library import lab_configuration
from pcmrs.testing.needs import Need
from pcmrs.testing.networks import NEEDS, Machine, Namespaces, lan
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import UNKNOWN, record

WIDER: Final = "[multicast]\nResolveScope = link\n[log]\nlevel = -3\n"
"""Configuration file of a lab for streams of its whole network."""
WARNING: Final = "lsl_configured_by_lab"

OFFER: Final = """
import time
from pcmrs.devices.lsl.library import EMG, load_lsl
lsl = load_lsl()
outlet = lsl.StreamOutlet(lsl.StreamInfo(EMG, "EMG", 1, 100.0, lsl.cf_float32, "another-machine"))
print("ready", flush=True)
while True:
    outlet.push_sample([1.0])
    time.sleep(0.01)
"""

READ: Final = """
import json, select, sys
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import EMG
inlet, samples = Inlet(EMG, "EMG"), 0
print("ready", flush=True)
while samples < 100 and not select.select([sys.stdin], [], [], 0.02)[0]:
    samples += len(inlet.pull()[1])
print(json.dumps({"samples": samples, "problem": inlet.problem}))
"""
"""Reads the stream as the driver does, until it has 100 samples or its standard input ends."""

LOOKING: Final = 15.0
"""Time within which an available stream is read, s of the machine."""
LONGER: Final = 2.0
"""Additional search time of the reader with the default configuration, s of the machine."""


class Read(msgspec.Struct, frozen=True):
    """Result of a reader.

    Attributes:
        samples: Number of samples that it has read.
        problem: Reason why it has none; empty if it has some.
    """

    samples: int
    problem: str


def _is_installed() -> bool:
    """Return whether the module, and the library that it loads, are installed."""
    try:
        import pylsl  # noqa: F401
    except (ImportError, OSError, RuntimeError):
        return False
    return True


@fault(
    "A35",
    how="two network namespaces: a stream with the name of the cell's EMG is offered in the other one",
    needs=(*NEEDS, Need("pylsl", _is_installed)),
    tries={UNKNOWN: ["Lab Streaming Layer"]},
)
async def stream_of_another_machine(lab: Lab) -> Evidence:
    """By default the stream is not found; a reader with the lab's own file finds it, and logs a warning."""
    if own := lab_configuration():
        raise NotRun(f"{own} configures Lab Streaming Layer on this machine, so the default cannot be tested")
    return await asyncio.to_thread(_offered, lab.folder)


def _offered(folder: Path) -> Evidence:
    wider = folder / "lsl_api.cfg"
    wider.write_text(WIDER)
    with lan() as net:
        if not is_sham():
            _until_ready(_start(net, "other", OFFER, wider))
        closed, opened = _start(net, "cell", READ), _start(net, "cell", READ, wider)
        log_by_default, log_of_wider = _until_ready(closed), _until_ready(opened)
        taken = _read(opened, LOOKING)
        arrived = _segments(net)
        record(UNKNOWN, "Lab Streaming Layer")
        by_default = _read(closed, LONGER)
    expect(taken.samples > 0, f"With the scope opened, too, nothing was read: {taken.problem}.")
    expect(WARNING in log_of_wider, "No warning is logged although the scope is opened.")
    expect(WARNING not in log_by_default, f"By default a warning is logged: {log_by_default}")
    expect(by_default.samples == 0, f"By default {by_default.samples} samples of another machine were read.")
    expect("has not been found" in by_default.problem, f"By default another reason is given: {by_default.problem}.")
    return Evidence(
        "not found by default; an opened scope is logged",
        took_place={"tcp_segments_at_the_cells_machine": arrived},
        control_kind="permitted",
        control={"samples_with_the_scope_opened": taken.samples, "logged_where_it_is_opened": WARNING},
        details={"by_default": by_default.problem},
    )


def _start(
    net: Namespaces[Machine], machine: Machine, script: str, configuration: Path | None = None
) -> subprocess.Popen[str]:
    variables = [f"LSLAPICFG={configuration}"] if configuration else []
    pipe = subprocess.PIPE
    return net.start(machine, "env", *variables, sys.executable, "-c", script, stdin=pipe, stdout=pipe)


def _until_ready(process: subprocess.Popen[str]) -> str:
    """Wait until a script is ready and return the log before that."""
    assert process.stdout is not None
    log = ""
    while (line := process.stdout.readline()) != "ready\n":
        expect(bool(line), f"The script has ended: {log}")
        log += line
    return log


def _read(reader: subprocess.Popen[str], within: float) -> Read:
    """Return the result of a reader when it has enough samples, or the time is over."""
    with suppress(subprocess.TimeoutExpired):
        reader.wait(within)
    log, _ = reader.communicate()  # ends its standard input
    return msgspec.json.decode(log.splitlines()[-1], type=Read)


def _segments(net: Namespaces[Machine]) -> int:
    """Return the number of TCP segments that the cell's machine has received; streams use TCP, discovery UDP."""
    names, numbers = (line.split() for line in net.run("cell", "grep", "Tcp:", "/proc/net/snmp").stdout.splitlines())
    return int(numbers[names.index("InSegs")])
