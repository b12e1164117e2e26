"""Loads ``pylsl`` so that streams are found on a machine without any network, and that it is quiet."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import msgspec
import structlog

from pcmrs.errors import ConfigurationError

_log = structlog.get_logger(__name__)

CONFIGURATION_FILES = ("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg")
"""Where the library itself looks, besides the environment variable ``LSLAPICFG``; a lab's own file goes before ours."""

CONFIGURATION = """
[lab]
KnownPeers = {127.0.0.1}
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
[ports]
PortRange = 256
[log]
level = -3
"""
"""Streams are offered to, and looked for on, this machine only. They are asked for by unicast as well, since a machine
without network has no multicast: a stream takes up to four ports, and none beyond the range is asked. Only fatal errors
are printed: what matters comes as an error code."""

OPENED = (
    "The lab's own file configures Lab Streaming Layer. Streams have neither passwords nor encryption: if its "
    "ResolveScope is wider than machine, everybody on that network may read and replace them."
)

StreamName = Annotated[str, msgspec.Meta(pattern=r"^[^'\"]+$")]
"""Of a stream in configuration: streams are asked for by an XPath predicate, in which a quote would end it."""

EMG = "pcmrs_emg"
"""Name of the stream of the simulated muscle, and of an amplifier unless configured otherwise."""


@cache
def load_lsl() -> Any:
    """The module ``pylsl``, configured; the first call in a process decides.

    Raises:
        ConfigurationError: It is not installed, or its library cannot be loaded.
    """
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as error:
        raise ConfigurationError(
            f"Lab Streaming Layer cannot be used ({error}); install the extra `hardware`: "
            "install the extra hardware (docs/supply.md)."
        ) from None
    own = lab_configuration()
    if own is None:
        pylsl.set_config_content(CONFIGURATION)
    else:
        _log.warning("lsl_configured_by_lab", file=own, text=OPENED)
    return pylsl


def lab_configuration() -> str | None:
    """Path of the file with which the lab configures Lab Streaming Layer; None where PCMRS configures it."""
    if named := os.environ.get("LSLAPICFG"):
        return named
    return next((name for name in CONFIGURATION_FILES if Path(name).expanduser().exists()), None)
