"""The daemon: puts all parts together and runs them until it is told to end."""

from pcmrs.service.daemon import Daemon, Ready

__all__ = ["Daemon", "Ready"]
