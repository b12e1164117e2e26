"""The answering side of requests: several at once, errors, limits, and the end of a server."""

import asyncio
import json

import msgspec
import pytest
import zenoh

from pcmrs.bus import Bus, Empty
from pcmrs.bus.serving import ANSWERS
from pcmrs.errors import DeviceError, RefusalError, UnknownOutcomeError
from pcmrs.messages import DeviceReply, DeviceRequest, Snapshot
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, open_pair, plain_session, snapshot, sync


async def test_requests_run_side_by_side() -> None:
    async with open_pair() as (router, client):
        meet = asyncio.Barrier(5)

        async def wait_for_all(key: str, request: DeviceRequest) -> DeviceReply:
            await meet.wait()
            return DeviceReply(result=request.method)

        router.serve("dev/robot/cmd", DeviceRequest, wait_for_all)
        asked = [client.request("dev/robot/cmd", DeviceRequest(method=f"m{n}"), DeviceReply, TIMEOUT) for n in range(5)]
        replies = await asyncio.wait_for(asyncio.gather(*asked), TIMEOUT)
        assert [reply.result for reply in replies] == [f"m{n}" for n in range(5)]


@pytest.mark.parametrize(
    ("raised", "code", "says"),
    [
        (RefusalError("too_far", "3 m are too far.", distance=3.0), "too_far", "3 m are too far"),
        (ZeroDivisionError("division by zero"), "error", "ZeroDivisionError"),
    ],
)
async def test_an_error_in_the_handler_is_raised_at_the_asker(raised: Exception, code: str, says: str) -> None:
    async def fail(_: str, __: DeviceRequest) -> DeviceReply:
        raise raised

    async with open_pair() as (router, client):
        router.serve("dev/robot/cmd", DeviceRequest, fail)
        with pytest.raises(DeviceError, match=says) as error:
            await client.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, TIMEOUT)
        assert error.value.fields["reason"] == code


async def test_unsendable_reply_and_malformed_request_are_errors() -> None:
    async def answer_object(_: str, __: DeviceRequest) -> DeviceReply:
        return DeviceReply(result=object())

    async with open_pair() as (router, client):
        router.serve("dev/robot/cmd", DeviceRequest, answer_object)
        for request in (DeviceRequest(method="joints"), Empty()):
            with pytest.raises(DeviceError) as error:
                await client.request("dev/robot/cmd", request, DeviceReply, TIMEOUT)
            assert error.value.fields["reason"] == "malformed"


async def test_a_server_that_closes_leaves_its_askers_with_unknown() -> None:
    settings = new_cell()
    async with open_bus(settings) as router:
        server = await Bus.open(msgspec.structs.replace(settings, mode="client"))
        asked = asyncio.Event()

        async def never(_: str, __: DeviceRequest) -> DeviceReply:
            asked.set()
            await asyncio.Event().wait()
            raise AssertionError

        server.serve("dev/robot/cmd", DeviceRequest, never)
        await sync(router, server)
        request = router.request("dev/robot/cmd", DeviceRequest(method="follow"), DeviceReply, 600.0)
        pending = asyncio.ensure_future(request)
        await asyncio.wait_for(asked.wait(), TIMEOUT)
        await server.close()
        with pytest.raises(UnknownOutcomeError):
            await asyncio.wait_for(pending, TIMEOUT)


async def test_query_without_payload_reads_json_also_by_wildcard() -> None:
    async def present(_: str, __: Empty) -> Snapshot:
        return snapshot(12)

    async with open_pair() as (router, _):
        router.serve("svc/snapshot", Empty, present)
        with plain_session(router.settings) as session:
            for selector in (f"{router.prefix}/svc/snapshot", f"{router.prefix}/**"):
                (reply,) = await asyncio.to_thread(lambda: list(session.get(selector)))  # noqa: B023
                sample = reply.result
                assert isinstance(sample, zenoh.Sample)
                assert str(sample.key_expr) == f"{router.prefix}/svc/snapshot"
                assert json.loads(sample.payload.to_bytes())["sequence"] == 12


async def test_requests_above_the_limit_are_refused_with_the_limit() -> None:
    async with open_pair() as (router, client):
        let = asyncio.Event()

        async def answer(_: str, request: DeviceRequest) -> DeviceReply:
            await let.wait()
            return DeviceReply(result={"method": request.method})

        router.serve("dev/robot/svc/read", DeviceRequest, answer)
        request = DeviceRequest(method="read")
        asked = [
            asyncio.ensure_future(client.request("dev/robot/svc/read", request, DeviceReply, TIMEOUT))
            for _ in range(ANSWERS + 5)
        ]
        async with asyncio.timeout(TIMEOUT):
            while sum(each.done() for each in asked) < 5:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        let.set()
        replies = await asyncio.gather(*asked, return_exceptions=True)
        refused = [each for each in replies if isinstance(each, DeviceError)]
        assert {(each.fields["reason"], str(ANSWERS) in each.text) for each in refused} == {("busy", True)}
        assert (len(refused), sum(isinstance(each, DeviceReply) for each in replies)) == (5, ANSWERS)
