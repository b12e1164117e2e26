"""Impairment of a link as the fault of a row; a sham campaign has a link without it."""

from __future__ import annotations

from typing import Literal

from pcmrs.testing.impairment import NetworkImpairment
from pcmrs_lab.campaign.sham import is_sham


class InjectedImpairment(NetworkImpairment):
    """Behaviour of a link that an injection impairs; in a sham campaign everything passes at once."""

    @property
    def narrow(self) -> float | None:
        return None if is_sham() else super().narrow

    def passes(self, direction: Literal["towards", "back"]) -> bool:
        return is_sham() or super().passes(direction)

    def delays(self, now: float) -> list[float]:
        if is_sham():
            self.counted["sent"] += 1
            return [0.0]
        return super().delays(now)

    def wait(self, now: float) -> float:
        return 0.0 if is_sham() else super().wait(now)
