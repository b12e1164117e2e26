"""No key, token or password lies in the repository."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

LEFT_OUT = [f":!{pattern}" for pattern in ("docs/pictures", "requirements.lock", "*.meta", "*.svg", "*.stl", "*.ply")]
"""Pictures, hashes and Unity's identifiers."""
HOOK = Path(sys.executable).with_name("detect-secrets-hook")
# Nothing is asked of the services that a token would belong to; hashes and test vectors look random and are no secrets.
WORDS = [
    str(HOOK),
    "--no-verify",
    "--disable-plugin",
    "HexHighEntropyString",
    "--disable-plugin",
    "Base64HighEntropyString",
]

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(900)]


def scan(*files: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*WORDS, *files], cwd=ROOT, capture_output=True, text=True, check=False)


def test_no_secret_is_in_the_repository() -> None:
    listed = subprocess.run(["git", "ls-files", "--", *LEFT_OUT], cwd=ROOT, capture_output=True, text=True, check=True)
    found = scan(*listed.stdout.splitlines())
    assert found.returncode == 0, found.stdout


def test_a_private_key_would_be_found(tmp_path: Path) -> None:
    (tmp_path / "peer.pem").write_text("-----BEGIN " + "EC PRIVATE KEY-----\nMHcCAQEE\n")
    assert scan(str(tmp_path / "peer.pem")).returncode == 1
