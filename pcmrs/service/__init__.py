"""The daemon: connects all parts and runs them until it is stopped."""

from pcmrs.service._daemon import Daemon, Ready

__all__ = ["Daemon", "Ready"]
