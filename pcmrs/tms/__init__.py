"""Transcranial magnetic stimulation of the motor cortex: what a pulse evokes, and the intensity that it takes."""

from pcmrs.tms.intervals import IntervalSettings, check_count, check_interval
from pcmrs.tms.mep import Mep, judge_mep, waveform
from pcmrs.tms.mep_settings import MepSettings
from pcmrs.tms.recruitment import RESPONSE, Recruitment, draw
from pcmrs.tms.threshold import ThresholdHunt
from pcmrs.tms.threshold_settings import Estimate, Pulse, ThresholdMethod, ThresholdSettings

__all__ = [
    "RESPONSE",
    "Estimate",
    "IntervalSettings",
    "Mep",
    "MepSettings",
    "Pulse",
    "Recruitment",
    "ThresholdHunt",
    "ThresholdMethod",
    "ThresholdSettings",
    "check_count",
    "check_interval",
    "draw",
    "judge_mep",
    "waveform",
]
