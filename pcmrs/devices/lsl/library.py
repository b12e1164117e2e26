"""Loads ``pylsl`` so that streams are found on a machine without any network, and that it is quiet."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import msgspec

from pcmrs.errors import ConfigurationError

CONFIGURATION_FILES = ("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg")
"""Where the library itself looks, besides the environment variable ``LSLAPICFG``; a lab's own file goes before ours."""

CONFIGURATION = """
[lab]
KnownPeers = {127.0.0.1}
[log]
level = -3
"""
"""Streams of this machine are asked for by unicast as well as by multicast, which a machine without network has not;
only fatal errors are printed: what matters comes as an error code."""

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
            "pip install 'pcmrs[hardware]'."
        ) from None
    if "LSLAPICFG" not in os.environ and not any(Path(name).expanduser().exists() for name in CONFIGURATION_FILES):
        pylsl.set_config_content(CONFIGURATION)
    return pylsl
