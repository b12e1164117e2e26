"""After a power cut a disk keeps what was synchronised, and of the rest anything that a disk may keep."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from pcmrs_lab.campaign.power_loss import SECTOR, PowerCut, _Disk, power_cuts

FOLDER = Path("/disk")
FILE = "/disk/a"
SEEDS = range(40)


def coded(text: str | bytes) -> str:
    raw = text.encode() if isinstance(text, str) else text
    return '"' + "".join(f"\\x{byte:02x}" for byte in raw) + '"'


def descriptor(path: str, number: int = 3) -> str:
    return f"{number}<{coded(path)[1:-1]}>"


def create(path: str = FILE, thread: int = 1) -> str:
    return f"{thread}  openat(AT_FDCWD<{coded('/')[1:-1]}>, {coded(path)}, O_RDWR|O_CREAT, 0644) = 3"


def write(data: bytes, path: str = FILE) -> str:
    return f"1  write({descriptor(path)}, {coded(data)}, {len(data)}) = {len(data)}"


def write_at(place: int, data: bytes, path: str = FILE) -> str:
    return f"1  pwrite64({descriptor(path)}, {coded(data)}, {len(data)}, {place}) = {len(data)}"


def sync(path: str = FILE, result: str = "0") -> str:
    return f"1  fsync({descriptor(path)}) = {result}"


def rename(old: str, new: str) -> str:
    return f"1  rename({coded(old)}, {coded(new)}) = 0"


def unlink(path: str) -> str:
    return f"1  unlink({coded(path)}) = 0"


def left(*lines: str) -> list[dict[str, bytes]]:
    """What may be on the disk after these calls."""
    disk = _Disk(FOLDER)
    for line in lines:
        disk.replay(line)
    found = [disk.after_a_cut(random.Random(seed)) for seed in SEEDS]
    return [each for number, each in enumerate(found) if each not in found[:number]]


NAMED = (create(), sync("/disk"))
"""A file whose name is on the disk."""


def test_what_was_synchronised_stays() -> None:
    assert left(*NAMED, write(b"kept"), sync()) == [{"a": b"kept"}]


def test_what_was_not_may_be_lost() -> None:
    assert {each["a"] for each in left(*NAMED, write(b"kept"), sync(), write(b"lost"))} == {b"kept", b"keptlost"}


def test_sectors_are_lost_one_by_one() -> None:
    three = b"1" * SECTOR + b"2" * SECTOR + b"3"
    found = {each["a"] for each in left(*NAMED, write_at(0, three))}
    assert b"" in found
    assert three in found
    assert bytes(SECTOR) + b"2" * SECTOR in found
    assert b"1" * SECTOR + bytes(SECTOR) + b"3" in found
    assert len(found) == 8


def test_a_shortened_file_may_have_its_old_length() -> None:
    shorter = f"1  ftruncate({descriptor(FILE)}, 2) = 0"
    assert {each["a"] for each in left(*NAMED, write(b"kept"), sync(), shorter)} == {b"kept", b"ke"}
    assert left(*NAMED, write(b"kept"), shorter, sync()) == [{"a": b"ke"}]


def test_a_name_may_be_lost_even_if_its_file_was_synchronised() -> None:
    assert {frozenset(each) for each in left(create(), write(b"kept"), sync())} == {frozenset(), frozenset({"a"})}


def test_names_change_in_their_order() -> None:
    calls = (create("/disk/new"), sync("/disk/new"), rename("/disk/new", "/disk/a"), create("/disk/b"))
    assert {frozenset(each) for each in left(*calls)} == {
        frozenset(),
        frozenset({"new"}),
        frozenset({"a"}),
        frozenset({"a", "b"}),
    }
    assert {frozenset(each) for each in left(*calls, unlink("/disk/b"), sync("/disk"))} == {frozenset({"a"})}


def test_a_replaced_file_is_whole_or_the_old_one() -> None:
    calls = (*NAMED, write(b"old"), sync(), create("/disk/n"), write(b"new", "/disk/n"), sync("/disk/n"))
    assert {each["a"] for each in left(*calls, rename("/disk/n", FILE))} == {b"old", b"new"}


def test_a_call_that_failed_has_done_nothing() -> None:
    assert left(*NAMED, write(b"kept"), sync(), sync(FILE, "-1 EIO (Input/output error)")) == [{"a": b"kept"}]
    lost = left(*NAMED, write(b"lost"), sync(FILE, "-1 EIO (Input/output error)"))
    assert {each["a"] for each in lost} == {b"", b"lost"}
    assert left(f"1  openat(AT_FDCWD, {coded(FILE)}, O_CREAT) = -1 EACCES (Permission denied)") == [{}]


def test_a_sync_keeps_only_what_was_written_before_it_began() -> None:
    unfinished = f"2  fsync({descriptor(FILE)} <unfinished ...>"
    calls = (*NAMED, write(b"kept"), unfinished, write(b"lost"))
    assert {each["a"] for each in left(*calls, "2  <... fsync resumed>) = 0")} == {b"kept", b"keptlost"}
    failed = "2  <... fsync resumed>) = -1 EIO (Input/output error)"
    assert b"" in {each["a"] for each in left(*calls, failed)}
    assert b"" in {each["a"] for each in left(*calls)}, "it has not ended"


def test_a_name_is_kept_only_if_it_was_there_when_the_sync_began() -> None:
    unfinished = f"2  fsync({descriptor('/disk')} <unfinished ...>"
    calls = (create(), unfinished, create("/disk/b"), unlink(FILE), "2  <... fsync resumed>) = 0")
    assert {frozenset(each) for each in left(*calls)} == {frozenset({"a"}), frozenset({"a", "b"}), frozenset({"b"})}


def test_a_sync_that_another_one_overtook_takes_nothing_back() -> None:
    unfinished = f"2  fsync({descriptor('/disk')} <unfinished ...>"
    calls = (create(), unfinished, create("/disk/b"), sync("/disk"), "2  <... fsync resumed>) = 0")
    assert left(*calls) == [{"a": b"", "b": b""}]


@pytest.mark.parametrize("path", ["/elsewhere/a", "/disk/a-shm"])
def test_other_files_are_not_looked_at(path: str) -> None:
    assert left(create(path), write(b"x", path), sync(path), sync("/disk")) == [{}]


def acknowledge(*numbers: int) -> str:
    text = b"".join(b"%d\n" % number for number in numbers)
    return f"1  write({descriptor('/dev/null', 1)}, {coded(text)}, {len(text)}) = {len(text)}"


CALLS = [create("/lib/x"), *NAMED, write(b"1"), sync(), acknowledge(1, 2), write(b"2"), sync(), acknowledge(3)]


def cuts(seed: int, times: int = 200) -> list[PowerCut]:
    return list(power_cuts(FOLDER, CALLS, times, random.Random(seed)))


def test_the_power_is_cut_at_every_instant_in_order_of_time() -> None:
    found = cuts(1)
    instants = [cut.call for cut in found]
    assert instants == sorted(instants)
    assert set(instants) == set(range(1, len(CALLS) + 1)), "before the folder is used nothing can be lost"
    known = {cut.call: cut.acknowledged for cut in found}
    assert known[5] == []
    assert known[6] == [1, 2]
    assert known[len(CALLS)] == [1, 2, 3]


def test_nothing_acknowledged_is_lost_if_it_was_synced_first() -> None:
    for cut in cuts(2):
        needed = {0: b"", 2: b"1", 3: b"12"}[len(cut.acknowledged)]
        assert cut.files.get("a", b"").startswith(needed)


def test_the_same_seed_cuts_at_the_same_instants() -> None:
    assert cuts(3, 5) == cuts(3, 5) != cuts(4, 5)
