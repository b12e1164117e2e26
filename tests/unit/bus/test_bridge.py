"""Bridge: order, bounds, newest per key, and turns for the rest of the loop."""

import asyncio
import threading
from functools import partial

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bus.bridge import Bridge


async def until_idle() -> None:
    """Lets everything run that is due: the drain reschedules itself, so it is behind us only for a while."""
    for _ in range(1000):
        await asyncio.sleep(0)


async def test_ordered_calls_run_in_order_and_before_streams() -> None:
    bridge, ran = Bridge(asyncio.get_running_loop()), list[str]()
    bridge.post_newest("pose", partial(ran.append, "pose"))
    for number in range(20):
        assert bridge.post(partial(ran.append, f"command {number}"))
    await until_idle()
    assert ran == [*(f"command {number}" for number in range(20)), "pose"]


async def test_a_full_queue_rejects_and_recovers() -> None:
    bridge, ran = Bridge(asyncio.get_running_loop(), capacity=3), list[int]()
    assert [bridge.post(partial(ran.append, number)) for number in range(5)] == [True, True, True, False, False]
    assert (bridge.refused, bridge.waiting) == (2, 3)
    await until_idle()
    assert ran == [0, 1, 2]
    assert bridge.post(partial(ran.append, 9))
    await until_idle()
    assert ran == [0, 1, 2, 9]


async def test_events_run_before_commands_and_have_their_own_capacity() -> None:
    bridge, ran = Bridge(asyncio.get_running_loop(), capacity=2), list[str]()
    assert [bridge.post(partial(ran.append, f"command {number}")) for number in range(3)] == [True, True, False]
    posted = [bridge.post(partial(ran.append, f"event {number}"), urgent=True) for number in range(3)]
    assert posted == [True, True, False]
    assert bridge.waiting == 4
    await until_idle()
    assert ran == ["event 0", "event 1", "command 0", "command 1"]


def test_the_newest_value_of_each_key_arrives_whatever_the_order() -> None:
    @given(st.lists(st.tuples(st.sampled_from("abc"), st.integers())), st.integers(1, 4))
    def check(values: list[tuple[str, int]], most: int) -> None:
        async def run() -> list[tuple[str, int]]:
            bridge, seen = Bridge(asyncio.get_running_loop()), list[tuple[str, int]]()
            for key, value in values:
                bridge.post_newest(key, partial(seen.append, (key, value)), most)
            assert bridge.replaced == len(values) - bridge.waiting, "each that nobody will see is counted"
            await until_idle()
            return seen

        seen = asyncio.run(run())
        for key in "abc":
            sent = [value for each, value in values if each == key]
            assert [value for each, value in seen if each == key] == sent[-most:]
        assert len(seen) == sum(min(most, len([each for each, _ in values if each == key])) for key in "abc")

    check()


async def test_a_busy_key_does_not_starve_another() -> None:
    bridge, seen = Bridge(asyncio.get_running_loop()), list[str]()

    def again() -> None:
        seen.append("busy")
        if len(seen) < 100:
            bridge.post_newest("busy", again)

    bridge.post_newest("busy", again)
    bridge.post_newest("quiet", partial(seen.append, "quiet"))
    await until_idle()
    assert seen.index("quiet") == 1


async def test_the_loop_gets_a_turn_within_a_backlog() -> None:
    loop = asyncio.get_running_loop()
    bridge, ran = Bridge(loop), list[str]()
    for _ in range(100):
        bridge.post(partial(ran.append, "command"))
    await asyncio.sleep(0)
    loop.call_soon_threadsafe(ran.append, "stop")
    await until_idle()
    assert ran.index("stop") < 30
    assert len(ran) == 101


async def test_a_failing_handler_is_reported_and_the_next_one_runs() -> None:
    loop = asyncio.get_running_loop()
    reported: list[object] = []
    loop.set_exception_handler(lambda _, context: reported.append(context["exception"]))
    bridge, ran = Bridge(loop), list[int]()
    bridge.post(lambda: ran.extend(1 // 0 for _ in "x"))
    bridge.post(partial(ran.append, 2))
    await until_idle()
    assert ran == [2]
    assert isinstance(reported[0], ZeroDivisionError)


async def test_nothing_is_lost_between_threads() -> None:
    loop, ran = asyncio.get_running_loop(), list[int]()
    bridge = Bridge(loop, capacity=4000)
    threads = [
        threading.Thread(target=lambda: [bridge.post(partial(ran.append, number)) for number in range(1000)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        await asyncio.to_thread(thread.join)
    await until_idle()
    assert sorted(ran) == sorted(list(range(1000)) * 4)


async def test_a_closed_bridge_forgets_and_rejects() -> None:
    bridge, ran = Bridge(asyncio.get_running_loop()), list[int]()
    bridge.post(partial(ran.append, 1))
    bridge.post_newest("key", partial(ran.append, 2))
    bridge.close()
    assert not bridge.post(partial(ran.append, 3))
    bridge.post_newest("key", partial(ran.append, 4))
    await until_idle()
    assert ran == []
