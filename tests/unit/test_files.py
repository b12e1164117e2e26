"""Durable files are whole or as they were, and secrets are their owner's only."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.files import (
    SECRET,
    make_private,
    read_secret,
    settle_on_disk,
    sha256_of,
    whole_folder,
    write_durably,
)


def test_failed_write_leaves_the_old_file_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "table"
    write_durably(file, b"old", mode=0o644)

    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_durably(file, b"new", mode=0o644)
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_content_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[tuple[str, bool]] = []
    sync, file = os.fsync, tmp_path / "table"

    def spy(descriptor: int) -> None:
        sync(descriptor)
        order.append((Path(f"/proc/self/fd/{descriptor}").readlink().name, file.exists()))

    monkeypatch.setattr(os, "fsync", spy)
    write_durably(file, b"new", mode=0o644)
    assert order == [("table.part", False), (tmp_path.name, True)]


@pytest.mark.parametrize(("masked", "mode"), [(True, 0o600), (False, 0o644)])
def test_the_mask_counts_unless_told_otherwise(tmp_path: Path, masked: bool, mode: int) -> None:
    before = os.umask(0o077)
    try:
        write_durably(tmp_path / "table", b"new", mode=0o644, masked=masked)
    finally:
        os.umask(before)
    assert (tmp_path / "table").stat().st_mode & 0o777 == mode


def test_rest_of_an_interrupted_write_is_replaced(tmp_path: Path) -> None:
    """Even one that others could read: the secret gets a new file."""
    (tmp_path / "key.part").write_bytes(b"half")
    (tmp_path / "key.part").chmod(0o666)
    write_durably(tmp_path / "key", b"secret", mode=SECRET)
    assert read_secret(tmp_path / "key") == b"secret"
    assert not (tmp_path / "key.part").exists()


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o610, 0o601])
def test_secret_that_others_may_use_is_refused_with_the_remedy(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "key"
    file.write_bytes(b"hunter2")
    file.chmod(mode)
    with pytest.raises(ConfigurationError, match=f"chmod 600 {file}") as raised:
        read_secret(file)
    assert (raised.value.fields["mode"], raised.value.fields["limit"]) == (f"{mode:04o}", "0600")
    assert "hunter2" not in raised.value.text


def test_credential_of_service_manager_may_be_read_by_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its access list shows as mode 0440; the same file elsewhere is refused."""
    file = tmp_path / "key"
    file.write_bytes(b"secret")
    file.chmod(0o440)
    status = os.fstat
    monkeypatch.setattr(
        os, "fstat", lambda number: os.stat_result((*status(number)[:4], 0, *status(number)[5:]))
    )  # root
    with pytest.raises(ConfigurationError):
        read_secret(file)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert read_secret(file) == b"secret"
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path.parent))
    with pytest.raises(ConfigurationError):
        read_secret(file)


@pytest.mark.parametrize("before", [None, 0o755, 0o777, 0o750, 0o700, 0o500])
def test_private_folder_is_closed_to_others_and_stays_as_closed(tmp_path: Path, before: int | None) -> None:
    folder = tmp_path / "a" / "cell"
    if before is not None:
        folder.mkdir(parents=True)
        folder.chmod(before)
    make_private(folder)
    mode = folder.stat().st_mode & 0o777
    assert mode == (0o500 if before == 0o500 else 0o700)


def test_files_that_do_not_exist_need_not_be_settled(tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"x" * 10_000)
    settle_on_disk([tmp_path / "missing", tmp_path / "there"])
    assert (tmp_path / "there").read_bytes() == b"x" * 10_000


def test_hash_of_a_file_is_that_of_its_bytes(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abc")
    # FIPS 180-2, example of SHA-256
    assert sha256_of(tmp_path / "file").hex().startswith("ba7816bf8f01cfea414140de5dae2223")


def test_a_folder_is_whole_or_not_there(tmp_path: Path) -> None:
    with suppress(RuntimeError), whole_folder(tmp_path / "out") as part:
        (part / "first").write_text("1")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").mkdir()  # an empty one is taken
    with whole_folder(tmp_path / "out") as part:
        (part / "first").write_text("1")
        assert list((tmp_path / "out").iterdir()) == []
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    with pytest.raises(ConfigurationError, match="not empty"), whole_folder(tmp_path / "out"):
        pass
    assert (tmp_path / "out" / "first").read_text() == "1"
