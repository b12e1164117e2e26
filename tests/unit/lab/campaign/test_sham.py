"""A sham campaign injects nothing, in all that it starts, and nowhere else."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs_lab.campaign.sham import in_sham_campaign, inject_unless_sham, is_sham, sham


def test_an_act_is_left_out_only_within_the_context() -> None:
    acts: list[str] = []
    with sham():
        inject_unless_sham(lambda: acts.append("within"))
    inject_unless_sham(lambda: acts.append("after"))
    assert acts == ["after"]


def test_it_is_known_whether_a_fault_was_reached() -> None:
    with sham() as before:
        assert in_sham_campaign()
        assert not before.reached
    with sham() as after:
        assert is_sham()
    assert (before.reached, after.reached) == (False, True)
    assert not in_sham_campaign()


def test_an_error_ends_the_sham_campaign() -> None:
    with pytest.raises(RuntimeError), sham():
        raise RuntimeError
    assert not is_sham()


async def test_tasks_and_threads_of_a_sham_campaign_belong_to_it() -> None:
    async def look() -> bool:
        await asyncio.sleep(0)
        return is_sham()

    outside = asyncio.create_task(look())
    with sham():
        inside = asyncio.create_task(look())
        assert await asyncio.to_thread(is_sham)
    assert (await inside, await outside) == (True, False)
