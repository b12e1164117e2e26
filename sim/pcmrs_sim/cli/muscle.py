"""`pcmrs-sim muscle`: a subject's electromyogram on Lab Streaming Layer, without a daemon."""

from __future__ import annotations

import asyncio

import click

from pcmrs.background import background_task
from pcmrs.cli.printing import say, say_json
from pcmrs.devices.lsl.library import EMG
from pcmrs.devices.lsl.markers import PULSES
from pcmrs.errors import DeviceError, PcmrsError


@click.command()
@click.option("--seed", default=1, show_default=True, type=click.IntRange(min=0), help="Seed of the subject.")
@click.option("--hum", default="50", show_default=True, type=click.Choice(["50", "60"]), help="Mains frequency, Hz.")
@click.option("--preactivation", default=0.0, type=click.FloatRange(0.0, 1000.0), help="EMG of a tense muscle, uV.")
@click.option("--stream", default=EMG, show_default=True, help="Name of the EMG stream.")
@click.option("--markers", default=PULSES, show_default=True, help="Name of the stream of pulses that it answers.")
@click.option("--json", "as_json", is_flag=True, help="Print what is streamed as JSON.")
def muscle(seed: int, hum: str, preactivation: float, stream: str, markers: str, as_json: bool) -> None:
    """Stream the EMG of a simulated subject, who answers pulses.

    Pulses are markers such as {"pulse": 3, "intensity": 55.0}. The coil is at the subject's hot-spot; lines on standard
    input move it and change the muscle: `coil 5 0 0 30` (5 mm along its x, turned by 30 degrees), `no_mep on`,
    `preactivation 40`. Press Ctrl-C to end it.

    Example: pcmrs-sim muscle --seed 3 --hum 60
    """
    try:
        asyncio.run(_serve(seed, float(hum), preactivation, stream, markers, as_json))
    except PcmrsError as error:
        raise click.ClickException(error.text) from None


async def _serve(seed: int, hum: float, preactivation: float, stream: str, markers: str, as_json: bool) -> None:
    from pcmrs.clock import SystemClock
    from pcmrs_sim.cli.terminal import forward_lines, termination
    from pcmrs_sim.lsl.emg_bench import EmgBench
    from pcmrs_sim.lsl.streams import EmgOutlet, PulseInlet
    from pcmrs_sim.settings import MuscleSettings

    clock, ended = SystemClock(), termination()
    settings = MuscleSettings(hum_hz=hum, preactivation_uv=preactivation)
    bench = EmgBench(settings, seed, clock)
    outlet = EmgOutlet(stream, settings.rate_hz, bench.muscle.samples, clock)
    inlet = PulseInlet(markers, bench.stimulate, clock)

    def take(line: str) -> None:
        try:
            bench.execute(line)
        except DeviceError as error:
            say(error.text, err=True)

    forward_lines(take)
    _print_streams({"stream": stream, "rate_hz": settings.rate_hz, "markers": markers, "seed": seed}, as_json)
    async with background_task(outlet.run()), background_task(inlet.run()):
        await ended.wait()


def _print_streams(streams: dict[str, object], as_json: bool) -> None:
    if as_json:
        say_json(streams)
        return
    text = "EMG stream {stream!r} at {rate_hz} Hz; pulses from the markers {markers!r}; subject {seed}. Ctrl-C ends it."
    say(text.format(**streams))
