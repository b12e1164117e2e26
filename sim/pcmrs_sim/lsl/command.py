"""`pcmrs-sim muscle`: a subject's electromyogram on Lab Streaming Layer, without a daemon."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

import click

from pcmrs.background import background_task
from pcmrs.devices.lsl.library import EMG
from pcmrs.devices.lsl.markers import PULSES
from pcmrs.errors import DeviceError, PcmrsError


@click.command()
@click.option("--seed", default=1, show_default=True, type=click.IntRange(min=0), help="Which subject.")
@click.option("--hum", default="50", show_default=True, type=click.Choice(["50", "60"]), help="Mains, Hz.")
@click.option("--preactivation", default=0.0, type=click.FloatRange(0.0, 1000.0), help="EMG of a tense muscle, uV.")
@click.option("--stream", default=EMG, show_default=True, help="Name of the EMG stream.")
@click.option("--markers", default=PULSES, show_default=True, help="Name of the stream of pulses that it answers.")
@click.option("--json", "as_json", is_flag=True, help="Say in JSON what is streamed.")
def muscle(seed: int, hum: str, preactivation: float, stream: str, markers: str, as_json: bool) -> None:
    """Stream the EMG of a simulated subject, who answers pulses.

    Pulses are markers such as {"pulse": 3, "intensity": 55.0}. The coil is at the subject's hot-spot; lines on standard
    input move it and change the muscle: `coil 5 0 0 30` (5 mm along its x, turned by 30 degrees), `no_mep on`,
    `preactivation 40`. It ends with Ctrl-C.

    Example: pcmrs-sim muscle --seed 3 --hum 60
    """
    try:
        asyncio.run(_serve(seed, float(hum), preactivation, stream, markers, as_json))
    except PcmrsError as error:
        raise click.ClickException(error.text) from None


async def _serve(seed: int, hum: float, preactivation: float, stream: str, markers: str, as_json: bool) -> None:
    from pcmrs.clock import SystemClock
    from pcmrs_sim.lsl.emg_bench import EmgBench
    from pcmrs_sim.lsl.streams import EmgOutlet, PulseInlet
    from pcmrs_sim.settings import MuscleSettings

    clock, ended = SystemClock(), asyncio.Event()
    settings = MuscleSettings(hum_hz=hum, preactivation_uv=preactivation)
    bench = EmgBench(settings, seed, clock)
    outlet = EmgOutlet(stream, settings.rate_hz, bench.muscle.samples, clock)
    inlet = PulseInlet(markers, bench.stimulate, clock)
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, ended.set)
    _read_lines(bench.tell)
    _say({"stream": stream, "rate_hz": settings.rate_hz, "markers": markers, "seed": seed}, as_json)
    async with background_task(outlet.run()), background_task(inlet.run()):
        await ended.wait()


def _say(what: dict[str, object], as_json: bool) -> None:
    text = "EMG stream {stream!r} at {rate_hz} Hz; pulses from the markers {markers!r}; subject {seed}. Ctrl-C ends it."
    click.echo(json.dumps(what) if as_json else text.format(**what))


def _read_lines(tell: Callable[[str], None]) -> None:
    """Passes lines of standard input on, from a thread of its own: a file cannot be waited for otherwise."""
    loop = asyncio.get_running_loop()

    def take(line: str) -> None:
        try:
            tell(line)
        except DeviceError as error:
            click.echo(error.text, err=True)

    def read() -> None:
        with suppress(RuntimeError, OSError):  # the loop has ended; the terminal listens to somebody else
            for line in filter(str.strip, sys.stdin):
                loop.call_soon_threadsafe(take, line)

    # In the background of a shell ("pcmrs-sim muscle &") reading from the terminal would stop the whole process.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=read, daemon=True, name="standard input").start()
