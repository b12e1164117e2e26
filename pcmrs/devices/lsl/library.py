"""Loading of ``pylsl``, configured to find streams on a machine without a network and to print only fatal errors."""

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
"""Files that the library reads, besides the environment variable ``LSLAPICFG``; they take precedence over ours."""

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
"""Default configuration of the library: streams are offered and searched on this machine only.

They are also searched by unicast, because a machine without a network has no multicast: a stream takes up to four
ports, and no port beyond the range is asked. Only fatal errors are printed; all others are returned as error codes.
"""

OPENED = (
    "The lab's own file configures Lab Streaming Layer. Streams have neither passwords nor encryption: if its "
    "ResolveScope is wider than machine, everyone on that network can read and replace them."
)

StreamName = Annotated[str, msgspec.Meta(pattern=r"^[^'\"]+$")]
"""Name of a stream in the configuration, without quotes: a quote would end the XPath predicate that finds it."""

EMG = "pcmrs_emg"
"""Name of the stream of the simulated muscle, and default name of an amplifier's stream."""


@cache
def load_lsl() -> Any:
    """Return the module ``pylsl``; the first call in a process configures it.

    Raises:
        ConfigurationError: The module is not installed, or its library cannot be loaded.
    """
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as error:
        raise ConfigurationError(
            f"Lab Streaming Layer cannot be used ({error}): install the extra hardware (docs/supply.md)."
        ) from None
    own = lab_configuration()
    if own is None:
        pylsl.set_config_content(CONFIGURATION)
    else:
        _log.warning("lsl_configured_by_lab", file=own, text=OPENED)
    return pylsl


def lab_configuration() -> str | None:
    """Return the path of the lab's own configuration of Lab Streaming Layer; None if PCMRS configures it."""
    if named := os.environ.get("LSLAPICFG"):
        return named
    return next((name for name in CONFIGURATION_FILES if Path(name).expanduser().exists()), None)
