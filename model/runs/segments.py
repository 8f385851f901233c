"""Measured segments of 1 m as columns: the value that calibration, training and evaluation work on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
from joulemap.model.runs.table import add_count

FloatArray = NDArray[np.float64]

_UNDRIVEN = 0.15  # of the usual current: a run that draws less was not driven


@dataclass(frozen=True)
class Segments:
    """Measured segments, and stationary intervals of the same runs.

    Attributes
    ----------
    x, y : ndarray of float, (n,)
        Centre [m].
    heading_rad : ndarray of float, (n,)
        Of p -> q.
    energy_j : ndarray of float, (n,)
        Drawn from the battery [J], or charge [A s] if `charge`.
    duration_s : ndarray of float, (n,)
        From p to q.
    driven_m : ndarray of float, (n,)
        Horizontal length of the track.
    heading_change_rad : ndarray of float, (n,)
        Of the track from p to q, positive to the right.
    turned_abs_rad : ndarray of float, (n,)
        Turns to both sides, added up.
    gentle_turn_rad : ndarray of float, (n, 7)
        The same, where a rate of turning counts only up to each of `track.TURN_LIMITS_RADPS`.
    gained_m2ps2 : ndarray of float, (n,)
        Sum of the increases of half the squared speed between p and q [m^2/s^2]; decreases do not count.
    voltage_v : ndarray of float, (n,)
        Mean; NaN where it was not recorded.
    current_a : ndarray of float, (n,)
        Mean.
    ripple : ndarray of float, (n,)
        Mean square of the current over the square of its mean.
    t0 : ndarray of float, (n,)
        Stamp at p [s].
    run : ndarray of int, (n,)
        Index into `runs`.
    runs : tuple of str
        Names of the runs.
    length_m : float
        Straight length of a segment.
    charge : bool
        Whether `energy_j` is charge.
    extras : dict of str to ndarray of float, (n,)
        Mean of each further column of numbers; NaN where blank.
    texts : dict of str to ndarray of str, (n,)
        Columns of text, in the middle of the segment.
    stationary : tuple of (int, float, float)
        Run, duration [s] and energy of every stationary interval of 2 s or more, without its first and last half
        second.
    left_out : dict
        Count by reason.
    """

    x: FloatArray
    y: FloatArray
    heading_rad: FloatArray
    energy_j: FloatArray
    duration_s: FloatArray
    driven_m: FloatArray
    heading_change_rad: FloatArray
    turned_abs_rad: FloatArray
    gentle_turn_rad: FloatArray
    gained_m2ps2: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray
    ripple: FloatArray
    t0: FloatArray
    run: NDArray[np.int64]
    runs: tuple[str, ...]
    length_m: float = 1.0
    charge: bool = False
    extras: dict[str, FloatArray] = field(default_factory=dict)
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    stationary: tuple[tuple[int, float, float], ...] = ()
    left_out: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for item in fields(self):
            values = getattr(self, item.name)
            if isinstance(values, np.ndarray):
                values.setflags(write=False)

    def __len__(self) -> int:
        return int(self.x.size)

    def take(self, which: ArrayLike) -> Segments:
        """Return some of the segments; `runs`, `stationary` and `left_out` stay.

        Parameters
        ----------
        which : array_like
            A mask, or indices.

        Returns
        -------
        Segments
            In the order of `which`.
        """
        index = np.asarray(which)
        per_segment = {f.name: getattr(self, f.name) for f in fields(self)}
        changed: dict[str, Any] = {k: v[index] for k, v in per_segment.items() if isinstance(v, np.ndarray)}
        changed["extras"] = {key: values[index] for key, values in self.extras.items()}
        changed["texts"] = {key: values[index] for key, values in self.texts.items()}
        return replace(self, **changed)


def concatenate(parts: Sequence[Segments]) -> Segments:
    """Join the segments of several runs.

    Parameters
    ----------
    parts : sequence of Segments
        At least one. A column that some part lacks is NaN, or an empty text, there.

    Returns
    -------
    Segments
        Of all runs.

    Raises
    ------
    InputError
        If parts mix energy with charge, or lengths.
    """
    if not parts:
        raise InputError("there are no segments to put together")
    if len({(p.charge, p.length_m) for p in parts}) > 1:
        raise InputError("segments of energy and of charge, or of different lengths, cannot be put together")
    offsets = np.cumsum([0] + [len(p.runs) for p in parts])
    names = sorted({key for p in parts for key in p.extras})
    words = sorted({key for p in parts for key in p.texts})
    plain = [f.name for f in fields(Segments) if isinstance(getattr(parts[0], f.name), np.ndarray) and f.name != "run"]
    left_out: dict[str, int] = {}
    for part in parts:
        for key, count in part.left_out.items():
            add_count(left_out, key, count)
    return Segments(
        **{key: np.concatenate([getattr(p, key) for p in parts]) for key in plain},
        run=np.concatenate([p.run + o for p, o in zip(parts, offsets, strict=False)]),
        runs=tuple(name for p in parts for name in p.runs),
        length_m=parts[0].length_m,
        charge=parts[0].charge,
        extras={k: np.concatenate([p.extras.get(k, np.full(len(p), np.nan)) for p in parts]) for k in names},
        texts={k: np.concatenate([p.texts.get(k, np.full(len(p), "")) for p in parts]) for k in words},
        stationary=tuple((r + int(o), t, e) for p, o in zip(parts, offsets, strict=False) for r, t, e in p.stationary),
        left_out=left_out,
    )


def driven_only(segments: Segments) -> Segments:
    """Leave out the runs that draw next to nothing.

    Their median current is below 15 % of that of the median run, as of a robot on a trailer, or of a stationary
    one whose positions wander. Their segments are counted as `undriven`. Nothing is left out of fewer than three runs.

    Parameters
    ----------
    segments : Segments
        Of all runs.

    Returns
    -------
    Segments
        Of the runs that were driven.
    """
    medians = {int(k): float(np.median(segments.current_a[segments.run == k])) for k in np.unique(segments.run)}
    if len(medians) < 3:
        return segments
    least = _UNDRIVEN * float(np.median(list(medians.values())))
    still = [k for k, current in medians.items() if current < least]
    if not still:
        return segments
    undriven = np.isin(segments.run, still)
    return replace(segments.take(~undriven), left_out=segments.left_out | {"undriven": int(undriven.sum())})
