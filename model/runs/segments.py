"""Measured segments of 1 m as columns: the value that calibration, training and evaluation work on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
from joulemap.model.runs.reckoning import WHEELS
from joulemap.model.runs.table import add_count

FloatArray = NDArray[np.float64]

_ROLLED_SHARE = 0.5  # wheels that slip roll more than the track; half of it is no calibration error of a wheel speed


@dataclass(frozen=True)
class Segments:
    """Measured segments, and stationary intervals of the same runs.

    Attributes
    ----------
    x, y : ndarray of float, (n,)
        Centre [m]; of segments along the track, the middle of their track.
    heading_rad : ndarray of float, (n,)
        Of p -> q; of segments along the track, the direction of travel in their middle.
    energy_j : ndarray of float, (n,)
        Drawn from the battery [J], or charge [A s] if `charge`.
    duration_s : ndarray of float, (n,)
        From p to q, without stops in between.
    driven_m : ndarray of float, (n,)
        Horizontal length of the track.
    heading_change_rad : ndarray of float, (n,)
        Of the track from p to q, positive to the right.
    turn_sd_rad : ndarray of float, (n,)
        Standard deviation of `heading_change_rad`; NaN where it is not known.
    turned_abs_rad : ndarray of float, (n,)
        Turns to both sides, added up.
    gained_m2ps2 : ndarray of float, (n,)
        Sum of the increases of half the squared speed between p and q [m^2/s^2]; decreases do not count.
    kinetic_m2ps2 : ndarray of float, (n,)
        Half the squared speed at q minus that at p [m^2/s^2].
    standing_s : ndarray of float, (n,)
        Of `duration_s`, the time in which the robot neither drives nor turns.
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
        Nominal length of a segment.
    charge : bool
        Whether `energy_j` is charge.
    of_motors : bool
        Whether that is the charge of the motors, summed, and not of the battery.
    extras : dict of str to ndarray of float, (n,)
        Mean of each further column of numbers; NaN where blank.
    texts : dict of str to ndarray of str, (n,)
        Columns of text, in the middle of the segment.
    stationary : tuple of (int, float, float)
        Run, duration [s] and energy of every stationary interval of 2 s or more, without its first and last half
        second.
    left_out : dict
        Count by reason.
    left_out_m : dict
        Metres by reason, as `left_out`.
    track_m : float
        Metres of track of all runs, with those that are left out.
    """

    x: FloatArray
    y: FloatArray
    heading_rad: FloatArray
    energy_j: FloatArray
    duration_s: FloatArray
    driven_m: FloatArray
    heading_change_rad: FloatArray
    turned_abs_rad: FloatArray
    gained_m2ps2: FloatArray
    kinetic_m2ps2: FloatArray
    standing_s: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray
    ripple: FloatArray
    t0: FloatArray
    run: NDArray[np.int64]
    runs: tuple[str, ...]
    length_m: float = 1.0
    charge: bool = False
    of_motors: bool = False
    extras: dict[str, FloatArray] = field(default_factory=dict)
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    stationary: tuple[tuple[int, float, float], ...] = ()
    left_out: dict[str, int] = field(default_factory=dict)
    left_out_m: dict[str, float] = field(default_factory=dict)
    track_m: float = 0.0
    turn_sd_rad: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if self.turn_sd_rad.size != self.x.size:
            object.__setattr__(self, "turn_sd_rad", np.full(self.x.size, np.nan))
        for item in fields(self):
            values = getattr(self, item.name)
            if isinstance(values, np.ndarray):
                values.setflags(write=False)

    def __len__(self) -> int:
        return int(self.x.size)

    @property
    def used_m(self) -> float:
        """Metres of track in these segments."""
        return float(self.driven_m.sum())

    def coverage(self) -> dict[str, Any]:
        """Return how much of the track is used.

        Returns
        -------
        dict
            JSON-able: `track_m`, metres driven; `used_m`, of these segments; `left_out_m`, metres by reason.
        """
        return {"track_m": self.track_m, "used_m": self.used_m, "left_out_m": dict(self.left_out_m)}

    def take(self, which: ArrayLike) -> Segments:
        """Return some of the segments; `runs`, `stationary` and what is said of whole runs stay.

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


def concatenate_segments(parts: Sequence[Segments]) -> Segments:
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
        If parts mix energy with charge.

    Notes
    -----
    Of different nominal lengths the largest is that of all.
    """
    if not parts:
        raise InputError("there are no segments to put together")
    if len({p.charge for p in parts}) > 1:
        raise InputError("segments of energy and of charge cannot be put together")
    offsets = np.cumsum([0] + [len(p.runs) for p in parts])
    names = sorted({key for p in parts for key in p.extras})
    words = sorted({key for p in parts for key in p.texts})
    plain = [f.name for f in fields(Segments) if isinstance(getattr(parts[0], f.name), np.ndarray) and f.name != "run"]
    left_out: dict[str, int] = {}
    left_out_m: dict[str, float] = {}
    for part in parts:
        for key, count in part.left_out.items():
            add_count(left_out, key, count)
        for key, metres in part.left_out_m.items():
            left_out_m[key] = left_out_m.get(key, 0.0) + metres
    return Segments(
        **{key: np.concatenate([getattr(p, key) for p in parts]) for key in plain},
        run=np.concatenate([p.run + o for p, o in zip(parts, offsets, strict=False)]),
        runs=tuple(name for p in parts for name in p.runs),
        length_m=max(p.length_m for p in parts),
        charge=parts[0].charge,
        of_motors=all(p.of_motors for p in parts),
        extras={k: np.concatenate([p.extras.get(k, np.full(len(p), np.nan)) for p in parts]) for k in names},
        texts={k: np.concatenate([p.texts.get(k, np.full(len(p), "")) for p in parts]) for k in words},
        stationary=tuple((r + int(o), t, e) for p, o in zip(parts, offsets, strict=False) for r, t, e in p.stationary),
        left_out=left_out,
        left_out_m=left_out_m,
        track_m=sum(part.track_m for part in parts),
    )


def driven_only(segments: Segments) -> Segments:
    """Leave out the runs in which the robot was carried.

    These are the runs with logged wheel speeds whose wheels rolled less than half of the track. Their metres are
    counted as `undriven`. A run without wheel speeds is kept: what it draws does not decide whether it is used.

    Parameters
    ----------
    segments : Segments
        Of all runs.

    Returns
    -------
    Segments
        Of the runs that were driven.
    """
    # metres, or radians: no wheel has a radius above 1 m
    wheels = [np.abs(segments.extras[key]) for key in chain(*WHEELS) if key in segments.extras]
    if not wheels:
        return segments
    rolled = np.max(wheels, axis=0) * segments.duration_s  # NaN where a side is not known
    members = [np.flatnonzero(segments.run == k) for k in range(len(segments.runs))]
    carried = [m for m in members if rolled[m].sum() < _ROLLED_SHARE * segments.driven_m[m].sum()]
    if not carried:
        return segments
    rows = np.concatenate(carried)
    kept = segments.take(np.setdiff1d(np.arange(len(segments)), rows))
    left_out = dict(segments.left_out)
    add_count(left_out, "undriven", rows.size)
    metres = segments.left_out_m.get("undriven", 0.0) + float(segments.driven_m[rows].sum())
    return replace(kept, left_out=left_out, left_out_m=segments.left_out_m | {"undriven": metres})


def coverage_words(coverage: Mapping[str, Any]) -> str:
    """Return how much of the track is used, in words.

    Parameters
    ----------
    coverage : mapping
        Of `Segments.coverage`.

    Returns
    -------
    str
        Such as "459 of 491 m (93.6 %); left out: 32 m gaps".
    """
    track_m, used_m = coverage["track_m"], coverage["used_m"]
    share = f" ({used_m / track_m:.1%})".replace("%", " %") if track_m > 0 else ""
    left_out = sorted(coverage["left_out_m"].items(), key=lambda item: -item[1])
    reasons = ", ".join(f"{metres:,.0f} m {key.replace('_', ' ')}" for key, metres in left_out if metres >= 0.5)
    return f"{used_m:,.0f} of {track_m:,.0f} m{share}" + (f"; left out: {reasons}" if reasons else "")
