"""Registration of one frame to another from measured points, its accuracy, and the gates that decide about its use."""

from pcmrs.registration._accuracy import predict_tre
from pcmrs.registration._gates import RegistrationGate, RegistrationLimits
from pcmrs.registration._noise import NoiseEstimate, rms_spread
from pcmrs.registration._points import PointRegistration, register_points
from pcmrs.registration._verdict import RegistrationVerdict, judge
from pcmrs.registration.rigid import register_batch

__all__ = [
    "NoiseEstimate",
    "PointRegistration",
    "RegistrationGate",
    "RegistrationLimits",
    "RegistrationVerdict",
    "judge",
    "predict_tre",
    "register_batch",
    "register_points",
    "rms_spread",
]
