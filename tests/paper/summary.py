"""From results per seed to means, 95 % intervals, and the expected results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

METHODS = ("physics", "gp", "ridge", "resnet", "compact", "noise_floor", "map_floor")
"""Columns of the table."""

PAPER = {
    "V-A": 0.091,
    "V-B": 0.109,
    "V-C": 0.129,
    "V-E": 0.196,
    "V-E shifted": 0.126,
    "V-E rest": 0.094,
    "V-E other": 0.122,
}
"""Mean relative errors of the paper's network (section V; figures 5, 6, 7, 10 and 11)."""
PAPER_PHYSICS = {"V-A": 0.236, "V-D": 0.108}
"""Those of its physics baseline: one friction coefficient; five metres for the next five (figure 8)."""
PAPER_STRATEGY = "resnet_finetuned"
"""The strategy that the paper finds best and reports."""

BARTLETT_ROUTE = 0.066
"""Error of energy over whole routes in Bartlett et al., IROS 2016."""


@dataclass(frozen=True)
class Interval:
    """A mean over seeds with its 95 % confidence interval (Student's t).

    Attributes
    ----------
    mean : float
        Over the seeds.
    half : float
        Half width of the interval; NaN for a single seed.
    seeds : int
        How many.
    """

    mean: float
    half: float
    seeds: int

    @classmethod
    def of(cls, values: Iterable[float]) -> Interval:
        """Compute the interval of some values."""
        numbers = np.asarray(list(values), dtype=np.float64)
        n = int(numbers.size)
        half = float("nan")
        if n > 1:
            half = float(student.ppf(0.975, n - 1) * numbers.std(ddof=1) / np.sqrt(n))
        return cls(float(numbers.mean()), half, n)

    def words(self) -> str:
        """Return the interval in percent: "9.1 ± 0.4", or "9.1 (1 seed)"."""
        if self.seeds == 1:
            return f"{100 * self.mean:.1f} (1 seed)"
        return f"{100 * self.mean:.1f} ± {100 * self.half:.1f}"

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return {"mean": self.mean, "half_width_95": self.half if self.seeds > 1 else None, "seeds": self.seeds}


class Summary:
    """All results of a reproduction by method, test set and number."""

    def __init__(self, results: Sequence[Mapping[str, Any]]) -> None:
        self.facts = {(r["kind"], int(r["seed"])): r for r in results}
        self._values: dict[tuple[str, str], dict[int, Mapping[str, Any]]] = {}
        for result in results:
            for method, rows in result.get("methods", {}).items():
                for row, found in rows.items():
                    self._values.setdefault((method, row), {})[int(result["seed"])] = found

    @property
    def methods(self) -> list[str]:
        """All methods, in the order of their results."""
        return list(dict.fromkeys(method for method, _ in self._values))

    def rows(self, method: str) -> list[str]:
        """Return the test sets of a method."""
        return [row for name, row in self._values if name == method]

    def seeds(self, method: str, row: str, number: str = "mean_relative_error") -> dict[int, float]:
        """Return a number of every seed. Result: by seed; empty where there is no result."""
        return {seed: float(found[number]) for seed, found in self._values.get((method, row), {}).items()}

    def interval(self, method: str, row: str, number: str = "mean_relative_error") -> Interval | None:
        """Return the mean of a number over all seeds. Result: None where there is no result."""
        values = self.seeds(method, row, number)
        return Interval.of(values.values()) if values else None

    def best_resnet(self) -> str:
        """Return the strategy of the paper's network that is shown: the paper's best, where it was run."""
        there = [method for method in self.methods if method.startswith("resnet_") and "dirt" not in method]
        return PAPER_STRATEGY if PAPER_STRATEGY in there or not there else there[0]

    def name_of(self, column: str) -> str:
        """Return the method of a column of the table."""
        return self.best_resnet() if column == "resnet" else column

    def compared(self, row: str, method: str, other: str) -> list[tuple[float, float]]:
        """Return the mean relative errors of two methods on the same seeds."""
        mine, its = self.seeds(method, row), self.seeds(other, row)
        return [(mine[seed], its[seed]) for seed in sorted(mine.keys() & its.keys())]

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers per seed and over seeds, JSON-able."""
        numbers = ("mean_relative_error", "route_relative_error", "with_turns")
        document: dict[str, Any] = {"methods": {}, "checks": [check.as_dict() for check in checks(self)]}
        for method, row in self._values:
            entry: dict[str, Any] = {"seeds": self._values[method, row]}
            for number in numbers:
                interval = self.interval(method, row, number)
                if interval is not None:
                    entry[number] = interval.as_dict()
            document["methods"].setdefault(method, {})[row] = entry
        document["metres"] = {str(seed): r["metres"] for (kind, seed), r in self.facts.items() if kind == "field"}
        document["seconds"] = {f"{kind}_{seed}": r["seconds"] for (kind, seed), r in self.facts.items()}
        return document


@dataclass(frozen=True)
class Check:
    """One expected result.

    Attributes
    ----------
    wanted : str
        What was expected, in words.
    found : str
        What was found.
    holds : bool
        Whether it is as expected.
    """

    wanted: str
    found: str
    holds: bool

    def as_dict(self) -> dict[str, Any]:
        """Return the result, JSON-able."""
        return {"wanted": self.wanted, "found": self.found, "holds": self.holds}


def checks(summary: Summary) -> list[Check]:
    """Compare the results with all expectations for which there are results; means over seeds decide."""
    made: list[Check] = []
    for row in ("V-A", "V-B", "V-C"):
        gaps = [100 * (physics - ours) for ours, physics in summary.compared(row, "compact", "physics")]
        if gaps:
            made.append(
                Check(
                    f"{row}: the error of one fitted friction is at least 10 points larger than the compact network's",
                    f"{np.mean(gaps):.1f} points (least seed {min(gaps):.1f})",
                    float(np.mean(gaps)) >= 10.0,
                )
            )
    for row, limit in (("V-A", 1.10), ("V-B", 1.10), ("V-C", 1.20)):
        ratios = [ours / floor for ours, floor in summary.compared(row, "compact", "map_floor")]
        if ratios:
            made.append(
                Check(
                    f"{row}: the compact network within {limit:.2f} of the map floor",
                    f"{np.mean(ratios):.2f} (worst seed {max(ratios):.2f})",
                    float(np.mean(ratios)) <= limit,
                )
            )
    for row, paper in PAPER.items():
        ours = summary.interval("compact", row)
        if ours is not None:
            made.append(Check(f"{row}: below the paper's {100 * paper:.1f} %", f"{ours.words()} %", ours.mean < paper))
    for row, limit, site in (("V-A", 0.03, "A"), ("V-B", 0.03, "A"), ("V-C", BARTLETT_ROUTE, "B")):
        route = summary.interval("compact", row, "route_relative_error")
        if route is not None:
            made.append(
                Check(
                    f"{row}: the error on whole routes on site {site} is less than {100 * limit:.1f} %",
                    f"{route.words()} %",
                    route.mean < limit,
                )
            )
    return made + _checks_of_other_heightmaps(summary)


def _checks_of_other_heightmaps(summary: Summary) -> list[Check]:
    """What is expected of V-A, on the other source of heightmaps than that of the main table.

    The map floor is always on surveys, so that it is no yardstick here.
    """
    made: list[Check] = []
    for source, words in (("driven", "driven positions"), ("survey", "a survey")):
        ours = summary.interval(f"compact_{source}", "V-A")
        physics = summary.interval(f"physics_{source}", "V-A")
        if ours is None:
            continue
        if physics is not None:
            made.append(
                Check(
                    f"V-A on a heightmap from {words}: the error of one fitted friction is at least 10 points larger "
                    "than the compact network's",
                    f"{100 * physics.mean:.1f} % and {100 * ours.mean:.1f} %",
                    physics.mean - ours.mean >= 0.10,
                )
            )
        paper = PAPER["V-A"]
        wanted = f"V-A on a heightmap from {words}: below the paper's {100 * paper:.1f} %"
        made.append(Check(wanted, f"{ours.words()} %", ours.mean < paper))
    return made
