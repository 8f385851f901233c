"""All layers of a heightmap together: prices, uncertainty and obstacles that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.layers.kinds import Kind
from joulemap.model.terrain.layers.layer import COST, FACTOR, FREE, HEIGHT, KINDS, Layer, check_numbers

_PLACES = 100_000  # of a map, for shares
_INSIDE = 1e-6  # of a square: what only touches it is not in it


@dataclass(frozen=True, eq=False, repr=False)
class Layers:
    """The layers of a heightmap; of several layers of kinds the last one that knows a place counts."""

    each: tuple[Layer, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.each)

    def of(self, *roles: str) -> list[Layer]:
        """Return the layers of some roles.

        Parameters
        ----------
        *roles : str
            Of `ROLES`.

        Returns
        -------
        list of Layer
            In their order.
        """
        return [layer for layer in self.each if layer.role in roles]

    @cached_property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of ground of all layers, each name once; the last layer says what it costs."""
        return tuple({kind.name: kind for layer in self.each for kind in layer.kinds}.values())

    def kind_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.int64]:
        """Return the number of the kind of ground in `kinds` at world points; -1 where no layer knows it.

        Parameters
        ----------
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray of int
            In the shape of the points.
        """
        number = {kind.name: k for k, kind in enumerate(self.kinds)}
        found = np.full(np.broadcast(x, y).shape, -1, dtype=np.int64)
        for layer in self.of(KINDS):
            own = np.array([*(number[kind.name] for kind in layer.kinds), -1])[layer.at(x, y)]
            found = np.where(own >= 0, own, found)
        return found

    def names_at(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.str_]:
        """Return the name of the kind of ground at world points; empty where no layer knows it.

        Parameters
        ----------
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray of str
            In the shape of the points.
        """
        return np.array([*(kind.name for kind in self.kinds), ""])[self.kind_at(x, y)]

    def kind_shares(self, frame: GridFrame) -> dict[str, float]:
        """Return which share of a map is of each kind of ground, by name, beside what is blocked.

        Parameters
        ----------
        frame : GridFrame
            Cells of a map.

        Returns
        -------
        dict
            Name -> share, 0..1.
        """
        if not self.kinds:
            return {}
        at = self.kind_at(*_sampled(frame))
        free = {k: kind.name for k, kind in enumerate(self.kinds) if not kind.blocked}
        known = max(int(np.isin(at, [-1, *free]).sum()), 1)
        return {name: float((at == k).sum()) / known for k, name in free.items()}

    def on_kinds(self, traction_per_m: NDArray[Any], robot: Robot, x: ArrayLike, y: ArrayLike) -> NDArray[Any]:
        """Return traction [J/m] on the kinds of ground at its places, by their defaults.

        Parameters
        ----------
        traction_per_m : ndarray
            As a model says it [J/m].
        robot : Robot
            Its weight and its own rolling resistance count.
        x, y : array_like
            World points [m].

        Returns
        -------
        ndarray
            Traction [J/m].
        """
        if not self.of(KINDS):
            return traction_per_m
        kind = self.kind_at(x, y)
        own, factor = robot.rolling_resistance, [1.0 if k.factor is None else k.factor for k in self.kinds]
        added = [
            robot.weight_n * ((own if k.rolling_resistance is None else k.rolling_resistance) - own) for k in self.kinds
        ]
        times, plus = np.array([*factor, 1.0])[kind], np.array([*added, 0.0])[kind]
        return _multiplied(traction_per_m, times) + plus.astype(traction_per_m.dtype)

    def std_of_kinds(
        self, traction_per_m: NDArray[Any], robot: Robot, x: ArrayLike, y: ArrayLike, learned: frozenset[str]
    ) -> NDArray[Any]:
        """Return the standard deviation of the defaults of kinds of ground, beside those that a model learned [J/m].

        Parameters
        ----------
        traction_per_m : ndarray
            As a model says it [J/m].
        robot : Robot
            Its weight and its own rolling resistance count.
        x, y : array_like
            World points [m].
        learned : frozenset of str
            Kinds whose cost a model learned.

        Returns
        -------
        ndarray
            [J/m].
        """
        own = [0.0 if kind.name in learned else kind.std for kind in self.kinds]
        both = list(zip(self.kinds, own, strict=True))
        share = [0.0 if kind.factor is None else std / max(kind.factor, 1e-3) for kind, std in both]
        of_weight = [std if kind.factor is None else 0.0 for kind, std in both]
        at, pull = self.kind_at(x, y), np.maximum(traction_per_m, 0.0)
        return np.asarray(robot.weight_n * np.array([*of_weight, 0.0])[at] + pull * np.array([*share, 0.0])[at])

    def priced(self, traction_per_m: NDArray[Any], x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike) -> NDArray[Any]:
        """Return traction [J/m] with factors and costs, which come on top of whatever a model says.

        A factor multiplies what the drives need, and not what the ground gives.

        Parameters
        ----------
        traction_per_m : ndarray
            As a model says it [J/m].
        x, y : array_like
            World points [m].
        heading_rad : array_like
            Headings [rad].

        Returns
        -------
        ndarray
            Traction [J/m].
        """
        for layer in self.of(FACTOR):
            traction_per_m = _multiplied(traction_per_m, np.nan_to_num(layer.at(x, y), nan=1.0))
        for layer in self.of(COST):
            if layer.function is None:
                cost = np.nan_to_num(np.asarray(layer.at(x, y), dtype=np.float64))
            else:
                cost = _asked(layer, traction_per_m.shape, x, y, heading_rad)
            traction_per_m = traction_per_m + cost.astype(traction_per_m.dtype)
        return traction_per_m

    def over(self, heights: NDArray[np.float32], frame: GridFrame) -> NDArray[np.float32]:
        """Return the heights of a map with those of layers of heights in their place.

        Parameters
        ----------
        heights : ndarray of float32, (rows, cols)
            Of the map [m].
        frame : GridFrame
            Its cells.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Of several layers the last one that knows a place counts.
        """
        for layer in self.of(HEIGHT):
            heights = layer.over(heights, frame)
        return heights

    @property
    def closing(self) -> list[Layer]:
        """The layers that may have obstacles."""
        return [layer for layer in self.each if layer.closes]

    @property
    def finest_m(self) -> float:
        """Side of the smallest cell of those [m]; infinite where there are none."""
        return min((layer.frame.resolution_m for layer in self.closing if layer.frame is not None), default=math.inf)

    def closed_on(self, frame: GridFrame) -> NDArray[np.bool_]:
        """Return which squares of a grid have a part of an obstacle, (rows, cols).

        Parameters
        ----------
        frame : GridFrame
            Cells of a map.

        Returns
        -------
        ndarray of bool, (rows, cols)
            True where an obstacle is.
        """
        closed = np.zeros(frame.shape, dtype=np.bool_)
        for layer in self.closing:
            assert layer.frame is not None
            count = max(2, math.ceil(frame.resolution_m / layer.frame.resolution_m - _INSIDE) + 1)
            for down in np.linspace(_INSIDE, 1.0 - _INSIDE, count) - 0.5:
                for right in np.linspace(_INSIDE, 1.0 - _INSIDE, count) - 0.5:
                    x, y = frame.xy(np.arange(frame.rows)[:, None] + down, np.arange(frame.cols)[None, :] + right)
                    closed |= layer.is_closed(x, y)
        return closed

    def warnings(self, frame: GridFrame) -> list[str]:
        """Return what a user should know of layers over a map: ground without a kind, kinds without a cost.

        Parameters
        ----------
        frame : GridFrame
            Cells of a map.

        Returns
        -------
        list of str
            Sentences; none where there is nothing to say.
        """
        found = []
        x, y = _sampled(frame)
        for layer in self.each:
            if layer.remark:
                found.append(f"of the layer {layer.source} {layer.remark}")
            if layer.role == HEIGHT:
                assert layer.frame is not None
                assert layer.values is not None
                area = np.count_nonzero(~np.isnan(layer.values)) * layer.frame.resolution_m**2
                found.append(f"the layer {layer.source} gives the heights of {area:,.1f} m2, in place of the map's")
            elif layer.frame is not None and (share := float(layer.knows(x, y).mean())) < 1.0 - 1e-3:
                outside = "an obstacle" if layer.role == FREE else "as without it"
                found.append(f"the layer {layer.source} covers {100.0 * share:.3g}% of the map: the rest is {outside}")
        free = [k.name for k in self.kinds if k.rolling_resistance is None and k.factor is None and not k.blocked]
        if free:
            found.append(
                f"the kinds of ground {', '.join(free)} have no cost of their own in the legend or the library: "
                "without runs on them they cost what the robot's own ground does"
            )
        return found

    def as_list(self) -> list[dict[str, Any]]:
        """Return what they are, JSON-able."""
        return [layer.as_dict() for layer in self.each]


def _sampled(frame: GridFrame) -> tuple[NDArray[Any], NDArray[Any]]:
    """Evenly spaced places of a map, as a row and a column."""
    x, y = frame.centres()
    step = max(1, math.ceil(math.sqrt(x.size * y.size / _PLACES)))
    return np.broadcast_arrays(x[None, ::step], y[::step, None])  # type: ignore[return-value]


def _multiplied(traction_per_m: NDArray[Any], times: NDArray[Any]) -> NDArray[Any]:
    return np.where(traction_per_m > 0.0, traction_per_m * times.astype(traction_per_m.dtype), traction_per_m)


def _asked(layer: Layer, shape: tuple[int, ...], *places: ArrayLike) -> NDArray[np.float64]:
    """What a function of the user's says of places."""
    assert layer.function is not None
    x, y, heading = (np.ascontiguousarray(np.broadcast_to(a, shape), dtype=np.float64).ravel() for a in places)
    cost = np.asarray(layer.function(x, y, heading), dtype=np.float64)
    if cost.shape not in ((), x.shape) or np.isnan(cost).any():
        raise InputError(
            f"the layer {layer.source} returned {cost.size} values for {x.size} places, or some that are no numbers: "
            "return one number of J/m for each place"
        )
    check_numbers(COST, cost, f"the layer {layer.source}")
    return np.broadcast_to(cost, x.shape).reshape(shape)


NO_LAYERS = Layers()
"""Of a heightmap without any."""
