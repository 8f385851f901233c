"""Whether something has changed: a cumulative sum of standardised innovations, to either side.

The threshold is that at which so many metres without a change raise an alarm with the stated probability. Innovations
are limited, and measured so that this holds on runs without a change: real ones are not quite independent.

Reference: Page 1954, "Continuous inspection schemes". Siegmund 1985, "Sequential Analysis", equation 2.57 (the average
run length).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

FALSE_ALARMS = 0.05
"""Setting: share of drives without a change in which an alarm is raised."""
SLACK = 0.25
"""Setting: half of the shift that is found soonest, in standard deviations of a metre; 30 % of the energy are about
half a standard deviation of the shipped network's metres."""


@dataclass
class Cusum:
    """Sums of what metres take beyond the forecast, and less than it, and where each began."""

    above: float = 0.0
    below: float = 0.0
    above_m: float = 0.0
    below_m: float = 0.0

    def add(self, step: float, at_m: float, threshold: float) -> tuple[str, float] | None:
        """Add a limited innovation, of variance 1, of the row that begins at a place.

        Result: "more" or "less" and where the change began [m], once a sum is above the threshold; both begin again.
        """
        if self.above == 0.0:
            self.above_m = at_m
        if self.below == 0.0:
            self.below_m = at_m
        self.above = max(0.0, self.above + step - SLACK)
        self.below = max(0.0, self.below - step - SLACK)
        if max(self.above, self.below) <= threshold:
            return None
        found = ("more", self.above_m) if self.above > self.below else ("less", self.below_m)
        self.above = self.below = 0.0
        return found


def threshold_of(metres: float, share: float = FALSE_ALARMS) -> float:
    """Return the threshold at which a share of unchanged drives of so many metres raises an alarm."""
    wanted = -2.0 * max(metres, 1.0) / math.log1p(-share)  # average run length of either side
    low, high = 0.0, 100.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        b = 2.0 * SLACK * (middle + 1.166)
        low, high = (middle, high) if (math.exp(b) - b - 1.0) / (2.0 * SLACK**2) < wanted else (low, middle)
    return high
