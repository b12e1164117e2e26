"""Registration of one frame to another from measured points, its accuracy, and the gates that decide about its use."""

from pcmrs.registration.accuracy import predict_tre
from pcmrs.registration.gates import RegistrationGate, RegistrationLimits
from pcmrs.registration.noise import NoiseEstimate, rms_spread
from pcmrs.registration.points import PointRegistration, register_points
from pcmrs.registration.rigid import register_batch
from pcmrs.registration.verdict import RegistrationVerdict, judge

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
