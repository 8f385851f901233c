"""Faults of the log: the robot takes no more energy, but the log says it at another time or place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.loop.generators.config import CaseConfig
from tests.loop.generators.effect import HiddenEffect
from tests.loop.generators.robots import TrueRobot


class LateMeter(HiddenEffect):
    """An ammeter whose readings come 0.5 to 1.5 s late."""

    kind = "late_meter"
    right = (r"(^|[^a-z])lag", r"delay", r"(^|[^a-z])late($|[^a-z])", r"clock offset")
    unit = "s"
    transfers = False
    either_sign = True

    def coefficients(self, robot: TrueRobot) -> tuple[float]:
        """Delay [s]."""
        return (self.size * (0.5 + self.draw[0]),)

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """The delay."""
        return replace(config, log=replace(config.log, lag_s=self.size * (0.5 + self.draw[0])))


class WrongDatum(HiddenEffect):
    """Positions that miss the map by 1 to 2 m, all in the same direction."""

    kind = "wrong_datum"
    right = (r"regist", r"shift", r"datum", r"map offset", r"offset of")
    unit = "m"
    transfers = False
    either_sign = True

    def coefficients(self, robot: TrueRobot) -> tuple[float, float]:
        """Shift of the logged positions to the east and to the north [m]."""
        return self._shift()

    def arranged(self, config: CaseConfig) -> CaseConfig:
        """The shift."""
        east, north = self._shift()
        return replace(config, log=replace(config.log, shift_m=(east, north)))

    def _shift(self) -> tuple[float, float]:
        distance, direction = self.size * (1.0 + self.draw[0]), 2 * np.pi * self.draw[1]
        return float(distance * np.sin(direction)), float(distance * np.cos(direction))


LOGS = (LateMeter, WrongDatum)
