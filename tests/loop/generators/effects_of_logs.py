"""Faults of the log: the robot takes no more energy, but the log says it at another time or place."""

from __future__ import annotations

from dataclasses import replace

from tests.loop.generators.config import CaseConfig
from tests.loop.generators.effect import HiddenEffect
from tests.loop.generators.robots import TrueRobot


class LateMeter(HiddenEffect):
    """An ammeter whose readings come 0.5 to 1.5 s late."""

    kind = "late_meter"
    right = (r"(^|[^a-z])lag", r"delay", r"(^|[^a-z])late($|[^a-z])", r"clock offset")
    unit = "s"
    transfers = False

    def coefficient(self, robot: TrueRobot) -> float:
        """Delay [s]."""
        return self.size * (0.5 + self.draw[0])

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """The delay."""
        return replace(config, log=replace(config.log, lag_s=self.size * (0.5 + self.draw[0])))


class WrongDatum(HiddenEffect):
    """Positions that miss the map by 1 to 2 m, all in the same direction."""

    kind = "wrong_datum"
    right = (r"regist", r"shift", r"datum", r"map offset", r"offset of")
    unit = "m"
    transfers = False

    def coefficient(self, robot: TrueRobot) -> float:
        """Distance [m]."""
        return self.size * (1.0 + self.draw[0])

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """The shift."""
        return replace(config, log=replace(config.log, shift_m=self.size * (1.0 + self.draw[0])))


LOGS = (LateMeter, WrongDatum)
