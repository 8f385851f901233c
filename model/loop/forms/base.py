"""What every form of an effect states: settings, unit, limits, covariates and words. One form is one class."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np

from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Form:
    """One way in which something may change the energy of a row. The fields of a subclass are its settings.

    Attributes
    ----------
    key : str
        Under which it is registered and written to files.
    label : str
        Name of the effect for a reader.
    meaning : str
        What a coefficient is, as part of a sentence.
    unit : str
        Of every coefficient; `{E}` is the unit of energy, J or A s, and `{P}` that of power.
    reveals : str
        Runs that would measure it better.
    low, high : float
        Physical limits of every coefficient.
    planned : bool
        Whether what it depends on is known before a drive.
    weather : bool
        Whether the same law holds in the baseline runs, which differ in the value of the covariate only.
    on_map : bool
        False for a fault of the log, which no plan contains.
    resists : bool
        Whether it is a force against the motion, which may make drives pull where they would brake.
    of_map : bool
        Whether it belongs to the map on which it was found, and is not there on another.
    extrapolates : bool
        Whether its formula is a law of physics, which holds beyond the range of its covariates in the runs.
    covariates : tuple of str
        Quantities that it depends on; nothing is tested where a logged column, `column:NAME`, is missing.
    options : mapping of str to sequence
        Values of each setting that are worth a test, in all combinations.
    pooled : bool
        Whether its coefficients are those of classes, of which a little known one is like the others.
    """

    key: ClassVar[str]
    label: ClassVar[str]
    meaning: ClassVar[str]
    unit: ClassVar[str]
    reveals: ClassVar[str]
    low: ClassVar[float] = -np.inf
    high: ClassVar[float] = np.inf
    planned: ClassVar[bool] = True
    weather: ClassVar[bool] = False
    on_map: ClassVar[bool] = True
    resists: ClassVar[bool] = False
    of_map: ClassVar[bool] = False
    extrapolates: ClassVar[bool] = False
    covariates: ClassVar[tuple[str, ...]] = ()
    options: ClassVar[Mapping[str, Sequence[Any]]] = {}
    pooled: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """The effect as reports and files call it; several forms may share one name."""
        return self.key

    @property
    def title(self) -> str:
        """What a reader sees for `name`."""
        return self.label

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the main effects that an interaction needs beside it (marginality, Nelder 1977)."""
        return ()

    @property
    def known_before(self) -> bool:
        """Whether plans contain it."""
        return self.planned and self.on_map

    def units(self, energy: str) -> tuple[str, ...]:
        """Return the unit of each coefficient.

        Parameters
        ----------
        energy : str
            Unit of the energy: J, or A s.

        Returns
        -------
        tuple of str
            As many as there are columns.
        """
        power = "W" if energy == "J" else "A"
        return (self.unit.format(E=energy, P=power),) * len(self.coefficient_names())

    def coefficient_names(self) -> tuple[str, ...]:
        """Return what each coefficient is called; a single one has the name of the effect."""
        return (self.name,)

    def column(self, rows: Features) -> FloatArray:
        """Return what the effect adds to each row, of a form with one coefficient.

        Parameters
        ----------
        rows : Features
            Of n rows.

        Returns
        -------
        ndarray of float, (n,)
            Energy [J], or charge [A s], per unit of the coefficient.
        """
        raise NotImplementedError

    def columns(self, rows: Features) -> FloatArray:
        """Return what the effect adds to each row.

        Parameters
        ----------
        rows : Features
            Of n rows.

        Returns
        -------
        ndarray of float, (n, k)
            Energy [J], or charge [A s], per unit of the k coefficients; 0 where a covariate is not known.
        """
        return np.nan_to_num(self.column(rows))[:, None]

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        """Yield the settings that are worth a test on these rows.

        Parameters
        ----------
        rows : Features
            Of the runs to calibrate on.

        Yields
        ------
        Form
            Every combination of the `options`; nothing where a column that it needs was not logged.
        """
        if all(name.removeprefix("column:") in rows.columns for name in cls.covariates if name.startswith("column:")):
            yield from (cls(**dict(zip(cls.options, values, strict=True))) for values in product(*cls.options.values()))

    def against_baseline(self) -> Form:
        """Return the form as it is tested in new runs against baseline runs, which say what its zero is."""
        return self

    def where(self, coefficients: tuple[float, ...]) -> str:
        """Return where the effect acts, in words.

        Parameters
        ----------
        coefficients : tuple of float
            As fitted.

        Returns
        -------
        str
            Part of a sentence.
        """
        return "everywhere"

    def as_dict(self) -> dict[str, Any]:
        """Return the form with its settings, JSON-able."""
        return {"form": self.key, **asdict(self)}


def steps(values: FloatArray, count: int) -> tuple[float, ...]:
    """Return quantiles at which a curve or a limit is placed.

    Parameters
    ----------
    values : ndarray of float
        As driven; NaN is left out.
    count : int
        How many.

    Returns
    -------
    tuple of float
        In rising order, without repetition.
    """
    known = values[np.isfinite(values)]
    if not known.size:
        return ()
    return tuple(float(v) for v in np.unique(np.quantile(known, np.linspace(0.02, 0.98, count)).round(9)))
