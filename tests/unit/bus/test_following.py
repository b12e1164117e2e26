"""The run of the daemon is taken from its heartbeats, and from nothing else."""

from __future__ import annotations

import msgspec

from pcmrs.bus.codec import pack
from pcmrs.bus.following import follow_daemon
from pcmrs.bus.seal import ReplayWindow, Seal, new_key, new_run
from pcmrs.errors import SealError
from pcmrs.messages import Beat
from pcmrs.testing.waiting import wait_until
from tests.unit.bus.bus_cells import new_cell, open_bus, plain_session

BEAT = Beat(number=1, session="a", alive=0.0, sent=0.0)


async def test_only_a_sealed_heartbeat_names_the_run() -> None:
    settings, key = new_cell(), new_key()
    daemon_seal, seal = Seal(key + new_run(), current_only=True), Seal(key)
    forged: list[tuple[str, str]] = []

    def on_forged(key: str, error: SealError) -> None:
        forged.append((key, error.fields["why"]))

    async with open_bus(settings, daemon_seal) as daemon:
        with plain_session(settings) as session, plain_session(settings) as stranger:
            beats = f"{daemon.prefix}/daemon/beat"
            follow_daemon(session, daemon.prefix, seal, on_forged)

            def put() -> bool:
                stranger.put(beats, pack(BEAT), attachment=Seal(new_key() + new_run()).put("put", beats, pack(BEAT)))
                return bool(forged)

            await wait_until(put)
            assert set(forged) == {("daemon/beat", "forged")}
            assert not seal.run_known()

            def beat() -> bool:
                daemon.publish("daemon/beat", BEAT)
                return seal.run_known()

            await wait_until(beat)
    report = seal.put("put", beats, b"")
    assert daemon_seal.check(report, ("put",), beats, b"", ReplayWindow()) == "put"


async def test_a_bus_without_a_run_takes_it_from_the_daemon() -> None:
    settings, key = new_cell(), new_key()
    seal = Seal(key)
    client = msgspec.structs.replace(settings, mode="client")
    async with open_bus(settings, Seal(key + new_run())) as daemon, open_bus(client, seal):

        def beat() -> bool:
            daemon.publish("daemon/beat", BEAT)
            return seal.run_known()

        await wait_until(beat)
