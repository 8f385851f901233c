"""A form with its coefficients: what a calibrated model adds to its base model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.loop.forms import Form, form_from_dict
from joulemap.model.loop.forms.base_parameters import BaseParameters, with_base_parameters
from joulemap.model.runs.features import SHARE_DRIVEN, Features

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Term:
    """A form with fitted coefficients.

    Attributes
    ----------
    form : Form
        What it depends on, and how.
    coefficients : tuple of float
        One for each column of the form.
    """

    form: Form
    coefficients: tuple[float, ...]

    def energy(self, rows: Features) -> FloatArray:
        """Return the energy that it adds to each row.

        Parameters
        ----------
        rows : Features
            Of n rows.

        Returns
        -------
        ndarray of float, (n,)
            Energy [J], or charge [A s].
        """
        return self.form.columns(rows) @ np.asarray(self.coefficients)

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-able mapping."""
        return {**self.form.as_dict(), "name": self.form.name, "coefficients": list(self.coefficients)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Term:
        """Read what `as_dict` returned.

        Parameters
        ----------
        values : mapping
            From a file.

        Returns
        -------
        Term
            The same.

        Raises
        ------
        ModelError
            If something is missing.
        """
        try:
            form = form_from_dict({k: v for k, v in values.items() if k not in ("name", "coefficients")})
            return cls(form, tuple(float(c) for c in values["coefficients"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"an effect of the model is not complete: {error!r}") from error


def prepared(rows: Features, first_base: Term | None, ranges: Mapping[str, tuple[float, float]]) -> Features:
    """Return rows as the terms of a calibration read them.

    Parameters
    ----------
    rows : Features
        Of n rows, with the drives that were fitted.
    first_base : Term, optional
        The base parameters that the energy of motion has in it.
    ranges : mapping
        In which quantities are held.

    Returns
    -------
    Features
        Of the same rows.
    """
    held = rows.within(ranges)
    if first_base is None or not isinstance(first_base.form, BaseParameters):
        return held
    return with_base_parameters(held, first_base.form, np.asarray(first_base.coefficients))


def total_energy(terms: Sequence[Term], rows: Features) -> FloatArray:
    """Return the energy that several terms add.

    Parameters
    ----------
    terms : sequence of Term
        Any number.
    rows : Features
        Of n rows.

    Returns
    -------
    ndarray of float, (n,)
        Energy [J], or charge [A s].
    """
    return np.sum([t.energy(rows) for t in terms], axis=0) if terms else np.zeros(len(rows))


def turning_per_rad(terms: Sequence[Term], rows: Features) -> float:
    """Return the cost of a radian of turning in plans.

    Parameters
    ----------
    terms : sequence of Term
        Of which those of turning count.
    rows : Features
        As driven.

    Returns
    -------
    float
        Cost [J/rad, or A s/rad].

    Notes
    -----
    The slope of the energy of turning over the angle that each row turned, in least squares: turns within a metre
    count, and the wandering of straight driving hardly does. Turns beyond the driven range, such as one on the spot
    whose peak of power a log may not show, are left out. For one term without a limit it is its coefficient.
    """
    moving = rows.take(~rows.standing)
    rows = moving.take(moving.turned_abs_rad <= np.quantile(moving.turned_abs_rad, 1.0 - SHARE_DRIVEN))
    turned = rows.turned_abs_rad
    rows = replace(rows, drives=replace(rows.drives, motor_speed_mps=None))
    energy = total_energy([t for t in terms if t.form.name == "turning"], rows)
    return float(turned @ energy) / max(float(turned @ turned), 1e-12)
