"""A process looks at its own certificate before anybody else does, and says what is wrong with it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority, read_credentials

DAY = 86400.0


@pytest.fixture
def now() -> float:
    return SystemClock().wall()


@pytest.fixture
def folder(tmp_path: Path, now: float) -> Path:
    """Of anna, for seven days, beside those of bob and of an anna of another authority."""
    authority = Authority.init(tmp_path / "pki", "lab", now)
    for name in ("anna", "bob"):
        authority.issue("operator", name, now, days=7.0, cells=("lab/c1", "lab/c2"), into=tmp_path)
    foreign = Authority.init(tmp_path / "foreign", "lab", now)
    foreign.issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path / "other")
    return tmp_path / "anna"


def test_issued_credentials_can_be_used(folder: Path, now: float) -> None:
    found = read_credentials(folder, now)
    assert (found.name, found.cells) == ("anna", ("lab/c1", "lab/c2"))
    assert {found.certificate, found.key, found.authority} == {
        str(folder / file) for file in ("anna.pem", "anna.key", "ca.pem")
    }


def test_a_certificate_counts_for_its_time(folder: Path, now: float) -> None:
    read_credentials(folder, now + 7 * DAY - 1.0)
    with pytest.raises(ConfigurationError, match=r"anna\.pem has expired on .* UTC.*set the clock"):
        read_credentials(folder, now + 7 * DAY + 1.0)
    with pytest.raises(ConfigurationError, match="set the clock"):
        read_credentials(folder, now - DAY)


def exchange(file: str, source: str) -> Callable[[Path], object]:
    return lambda folder: shutil.copy(folder.parent / source, folder / file)


@pytest.mark.parametrize(
    ("harm", "why"),
    [
        (lambda folder: (folder / "anna.key").chmod(0o644), "others than its owner may use this key"),
        (lambda folder: (folder / "anna.key").unlink(), "0 files that end in .key"),
        (lambda folder: shutil.copy(folder / "anna.key", folder / "other.key"), "2 files that end in .key"),
        (lambda folder: (folder / "anna.key").write_text("no key"), "is not a private key"),
        (lambda folder: (folder / "anna.pem").unlink(), "anna.pem cannot be read"),
        (lambda folder: (folder / "anna.pem").write_text("none"), "anna.pem cannot be read"),
        (lambda folder: (folder / "ca.pem").unlink(), "ca.pem cannot be read"),
        (exchange("anna.key", "bob/bob.key"), "anna.key does not belong to anna.pem"),
        (exchange("anna.pem", "other/anna/anna.pem"), "anna.key does not belong to anna.pem"),
        (exchange("ca.pem", "foreign/ca.pem"), "anna.pem was not issued by ca.pem"),
        (
            lambda folder: (exchange("anna.key", "bob/bob.key")(folder), exchange("anna.pem", "bob/bob.pem")(folder)),
            "the certificate of another identity",
        ),
    ],
)
def test_invalid_credentials_are_refused_with_the_reason(
    folder: Path, now: float, harm: Callable[[Path], object], why: str
) -> None:
    harm(folder)
    with pytest.raises(ConfigurationError, match=why):
        read_credentials(folder, now)
