"""Whether predictions are right on average: sums of predicted and measured energies of runs that were left out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student


@dataclass(frozen=True)
class MeanLevel:
    """Measured over predicted energy on runs that were left out."""

    ratio: float = 1.0  # Sum of the measured energies over that of the predicted ones
    std: float = float("inf")  # Standard error of the ratio, by a jackknife over runs; infinite for one run
    agrees: bool = True  # Whether 1 is within the 95 % confidence interval of the ratio
    factor: float = 1.0  # By which predictions are multiplied: 1 where the sums agree, and the ratio where they do not

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able: an infinite error as None."""
        return asdict(self) | {"std": self.std if np.isfinite(self.std) else None}


def mean_level(energy: ArrayLike, predicted: ArrayLike, run: ArrayLike, *, beside: ArrayLike = 0.0) -> MeanLevel:
    """Compare sums of measured and predicted energies.

    `energy`, `predicted` (n,): measured and predicted energies, in one unit; `run` (n,): the run of each, or whatever
    was left out together; `beside` (n,): what is known of both and not multiplied.

    The interval is Student's t with as many degrees of freedom as there are runs, minus one. A model that estimates the
    mean needs no factor; one of few runs would carry their chance into every prediction.

    Reference: Cochran 1977, "Sampling Techniques", section 6.17 (the jackknife of a ratio).
    """
    number = np.unique(np.asarray(run), return_inverse=True)[1]
    known = np.broadcast_to(np.asarray(beside, dtype=np.float64), number.shape)
    top, bottom = (
        np.bincount(number, weights=np.asarray(values, dtype=np.float64) - known) for values in (energy, predicted)
    )
    if bottom.sum() <= 0.0 or top.sum() <= 0.0:
        return MeanLevel()
    ratio, count = float(top.sum() / bottom.sum()), top.size
    if count < 2:
        return MeanLevel(ratio)
    others = (top.sum() - top) / (bottom.sum() - bottom)
    std = float(np.sqrt((count - 1) * np.mean((others - others.mean()) ** 2)))
    agrees = abs(ratio - 1.0) <= float(student.ppf(0.975, count - 1)) * std
    return MeanLevel(ratio, std, agrees, 1.0 if agrees else ratio)
