"""Faults before a daemon starts: libraries that are installed on its machine, certificates that are issued."""

from __future__ import annotations

import hashlib
import sys
import zipfile
from pathlib import Path

from pcmrs.clock import SystemClock
from pcmrs.pki import Authority
from pcmrs.testing.needs import module
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tools import ended

WHEEL = "harmless-1.0-py3-none-any.whl"
METADATA = {
    "METADATA": "Metadata-Version: 2.1\nName: harmless\nVersion: 1.0\n",
    "WHEEL": "Wheel-Version: 1.0\nGenerator: pcmrs\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "RECORD": "",
}


@fault("A39", how="a wheel for pip that was replaced after its hash was locked", needs=[module("pip")])
async def exchanged_library(lab: Lab) -> Evidence:
    """With the hash it is not installed; the locked one is, and without hashes the exchanged one would be."""
    wheel, lock = lab.folder / WHEEL, lab.folder / "requirements.lock"
    _make_wheel(wheel, "kind = 'the locked one'\n")
    locked = _digest(wheel)
    lock.write_text(f"harmless==1.0 --hash=sha256:{locked}\n")
    status, text = await _install(lab.folder, "first", "--require-hashes", "--requirement", str(lock))
    expect(status == 0, f"The locked wheel was not installed: {text}")
    if not is_sham():
        _make_wheel(wheel, "kind = 'another one'\n")
    offered = _digest(wheel)
    expect(offered != locked, "The wheel was not exchanged.")
    status, text = await _install(lab.folder, "second", "--require-hashes", "--requirement", str(lock))
    expect(status != 0 and locked in text and offered in text, f"pip ended with {status}: {text}")
    expect(not (lab.folder / "second" / "harmless.py").exists(), "The exchanged wheel was installed.")
    status_without, text = await _install(lab.folder, "third", "harmless==1.0")
    expect(status_without == 0, f"Without hashes it was not installed either: {text}")
    return Evidence(
        "not installed",
        took_place={"sha256_locked": locked, "sha256_offered": offered},
        control_kind="mutant",
        control={"installed_without_hashes": (lab.folder / "third" / "harmless.py").read_text().strip()},
        details={"status": status},
    )


@fault("A40", how="the command that issues certificates, with and without the cells for which they are valid")
async def certificate_for_no_cell(lab: Lab) -> Evidence:
    """Without a cell nothing is issued or registered; with one the certificate counts for that cell only."""
    folder = lab.folder / "pki"
    authority = Authority.init(folder, "lab", SystemClock().wall())
    words = ("pki", "issue", "operator", "anna", "--folder", str(folder), "--output", str(lab.folder))
    cells = ("--cell", "lab/cell1")
    status, refusal = await _run("pcmrs.cli", *words, *(cells if is_sham() else ()))
    expect(status == 2 and "--cell" in refusal, f"Without a cell pcmrs pki issue ended with {status}: {refusal}")
    expect(not authority.identities() and not (lab.folder / "anna").exists(), "A certificate was issued.")
    control, text = await _run("pcmrs.cli", *words, *cells)
    expect(control == 0, f"With a cell it ended with {control}: {text}")
    return Evidence(
        "refused with the reason",
        took_place={"said_without_a_cell": refusal.strip().splitlines()[-1]},
        control_kind="permitted",
        control={"issued_for": " ".join(authority.identities()[0].cells)},
        details={"status": status},
    )


def _make_wheel(path: Path, source: str) -> None:
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("harmless.py", source)
        for name, content in METADATA.items():
            wheel.writestr(f"harmless-1.0.dist-info/{name}", content)


async def _install(folder: Path, into: str, *words: str) -> tuple[int, str]:
    """Return status and last output of pip, which sees only the files in the folder."""
    own = ("--isolated", "--no-index", "--no-cache-dir", "--find-links", str(folder), "--target", str(folder / into))
    return await _run("pip", "install", *own, *words)


async def _run(module_name: str, *words: str) -> tuple[int, str]:
    """Return status and last output of a module that is run as a program."""
    status, output = await ended([sys.executable, "-m", module_name, *words])
    return status, output[-300:]


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
