"""An energy that is not known exactly: its quantiles, and how likely it is that a charge lasts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

QUANTILES = (0.05, 0.5, 0.95)
"""Shares of drives that take less energy than the quantiles that answers give."""
LIKELY, MARGINAL = 2.0 / 3.0, 1.0 / 3.0
SURE = 0.95
CLASSES = ("yes", "likely", "marginal", "no")
"""Classes of verdicts: yes from a probability of `SURE`, likely from `LIKELY`, marginal from `MARGINAL`, else no. The
limits are those of "extremely likely", "likely" and "unlikely" of Mastrandrea et al. 2010, "Guidance note for lead
authors of the IPCC fifth assessment report on consistent treatment of uncertainties"."""
UNSEEN_SHARE = 0.5
"""Scale of the error of a whole route that is assumed for the class of a verdict where the model has seen no runs, and
so gives no probability. Source: `python -m tests.coverage`, median error of equation 5 with the declared rolling
resistance on rough simulated ground."""


@dataclass(frozen=True, eq=False)
class EnergyOdds:
    """The distribution of energies up to some places of a drive: normal, or Student's t.

    Attributes
    ----------
    mean_j : ndarray of float, (n,)
        Expected energy from the start [J].
    scale_j : ndarray of float, (n,)
        Standard deviation of the normal distribution, or scale of Student's t [J].
    freedom : ndarray of float, (n,), or None
        Degrees of freedom, above 2; None for a normal distribution.
    bias : float
        By which share of the expected energy the median lies above it.
    skew : float
        Scale above the median over that below it; their geometric mean is `scale_j`.
    """

    mean_j: NDArray[np.float64]
    scale_j: NDArray[np.float64]
    freedom: NDArray[np.float64] | None = None
    bias: float = 0.0
    skew: float = 1.0

    @property
    def median_j(self) -> NDArray[np.float64]:
        """Energy that half of the drives do not exceed [J], (n,)."""
        return self.mean_j + self.bias * np.abs(self.mean_j)

    @property
    def std_j(self) -> NDArray[np.float64]:
        """Root mean square distance from the median [J], (n,): the standard deviation of equal sides."""
        std = self.scale_j * np.sqrt(0.5 * (self.skew + 1.0 / self.skew))
        return std if self.freedom is None else std * np.sqrt(self.freedom / (self.freedom - 2.0))

    def quantile(self, share: float) -> NDArray[np.float64]:
        """Return the energies that a share of drives does not exceed.

        `share`: between 0 and 1. Result (n,): energy [J].
        """
        from scipy.special import ndtri, stdtrit  # loads slowly, and few questions need it

        steps = ndtri(share) if self.freedom is None else stdtrit(self.freedom, share)
        return np.asarray(self.median_j + steps * self.scale_j * np.sqrt(self.skew if share > 0.5 else 1.0 / self.skew))

    def lasts(self, available_j: ArrayLike) -> NDArray[np.float64]:
        """Return the probabilities that no more energy is needed than there is.

        `available_j`: energy that may be used up to each place [J]. Result (n,): probability, 0 to 1.
        """
        from scipy.special import ndtr, stdtr

        margin = np.asarray(available_j, dtype=np.float64) - self.median_j
        known = self.scale_j > 0.0
        side = np.sqrt(np.where(margin > 0.0, self.skew, 1.0 / self.skew))
        steps = margin / np.where(known, self.scale_j * side, 1.0)
        probability = ndtr(steps) if self.freedom is None else stdtr(self.freedom, steps)
        return np.where(known, probability, margin >= 0.0)

    @property
    def final_std_j(self) -> float:
        """Standard deviation of the whole energy [J]."""
        return float(self.std_j[-1]) if self.mean_j.size else 0.0

    def final_quantile(self, share: float) -> float:
        """Return the energy that a share of drives does not exceed in all.

        `share`: between 0 and 1. Result: energy [J]; not below 0 where the drive takes energy everywhere.
        """
        if not self.mean_j.size:
            return 0.0
        freedom = None if self.freedom is None else self.freedom[-1:]
        end = replace(self, mean_j=self.mean_j[-1:], scale_j=self.scale_j[-1:], freedom=freedom)
        last = float(end.quantile(share)[0])
        rising = bool((np.diff(self.mean_j, prepend=0.0) >= 0.0).all())
        return max(last, 0.0) if rising else last


def class_of(probability: float) -> str:
    """Return the class of a verdict.

    `probability`: that the battery lasts. Result: one of `CLASSES`.
    """
    if probability >= SURE:
        return "yes"
    return "likely" if probability >= LIKELY else "marginal" if probability >= MARGINAL else "no"
