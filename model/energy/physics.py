"""Published closed forms of the energy of driving a metre, and the predictor that needs nothing else."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.drivetrain import geared
from joulemap.model.energy.grade import SEGMENT_M, tan_grade, tan_grade_lattice
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]


def eq5_traction_per_m(weight_n: ArrayLike, rolling_resistance: ArrayLike, tan_grade: ArrayLike) -> FloatArray:
    """Return the traction demand per horizontal metre. Shapes broadcast.

    Parameters
    ----------
    weight_n : array_like
        m g [N].
    rolling_resistance : array_like
        mu, dimensionless.
    tan_grade : array_like
        Tangent of the pitch along the motion, positive uphill.

    Returns
    -------
    ndarray of float64
        Traction demand [J/m]; negative where the ground pushes the robot.

    Notes
    -----
    m g (mu + tan theta): eq. 5, E = m g (mu cos theta + sin theta) d, with d = 1 / cos theta along the surface. Valid
    at constant speed on ground into which wheels do not sink and over which they do not bounce.

    References
    ----------
    Wei & Isler 2022, eq. 5.
    """
    grade = np.asarray(tan_grade, dtype=np.float64)
    return np.asarray(weight_n, dtype=np.float64) * (np.asarray(rolling_resistance, dtype=np.float64) + grade)


def fit_rolling_resistance(traction_per_m: ArrayLike, tan_grade: ArrayLike, *, weight_n: float) -> float:
    """Fit one mu to measured segments by least squares: the paper's global friction.

    Parameters
    ----------
    traction_per_m : array_like, (n,)
        Energy per horizontal metre without the hotel load [J/m]; NaN entries are left out.
    tan_grade : array_like, (n,)
        Grade; NaN entries are left out.
    weight_n : float
        m g [N].

    Returns
    -------
    float
        mu, dimensionless.

    Raises
    ------
    InputError
        If there is no finite pair, or the weight is not positive.

    Notes
    -----
    With t = m g (mu + tan theta) the solution is mean(t) / (m g) - mean(tan theta). Valid where nothing is clipped (no
    braking).

    References
    ----------
    Wei & Isler 2022, section V-D ("a least-square method can be used to fit a value for mu").
    """
    traction = np.asarray(traction_per_m, dtype=np.float64).ravel()
    grade = np.asarray(tan_grade, dtype=np.float64).ravel()
    if traction.shape != grade.shape:
        raise InputError(f"{traction.size} measured segments need as many grades, got {grade.size}")
    if not (math.isfinite(weight_n) and weight_n > 0):
        raise InputError(f"weight_n must be a positive number of newtons, got {weight_n}", weight_n=str(weight_n))
    known = np.isfinite(traction) & np.isfinite(grade)
    if not known.any():
        raise InputError("rolling resistance cannot be fitted: there is no segment with a known energy and grade")
    return float(traction[known].mean() / weight_n - grade[known].mean())


class PhysicsPredictor:
    """The paper's eq. 5 with the declared rolling resistance: untrained, exact on planes, blind to bumps.

    Attributes
    ----------
    name : str
        "physics".
    spread : Spread
        Assumed, because eq. 5 says nothing of its errors.
    """

    name = "physics"
    spread = Spread()

    def provenance(self) -> dict[str, Any]:
        """Return what the predictor is, JSON-able."""
        return {
            "name": self.name,
            "kind": "physics",
            "version": "1",
            "config": {"equation": "m g (mu + tan theta) per horizontal metre", "source": "Wei & Isler 2022, eq. 5"},
        }

    def warnings(self, heightmap: Heightmap, robot: Robot) -> list[str]:
        """Warn where eq. 5 is not valid: cells longer than the segment hide the pitch that it needs.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            Not used.

        Returns
        -------
        list of str
            One sentence, or none.
        """
        if heightmap.resolution_m > SEGMENT_M:
            return [
                f"the heightmap's cells are {heightmap.resolution_m:g} m, longer than the {SEGMENT_M:g} m segment "
                "whose pitch equation 5 needs: slopes within a cell are not seen"
            ]
        return []

    def traction_per_m(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> NDArray[np.float32]:
        """Return m g (mu + tan theta) at the cell centres of a lattice.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.
        frame : GridFrame
            Cells of the lattice.
        headings_rad : ndarray of float64, (K,)
            Headings [rad].

        Returns
        -------
        ndarray of float32, (rows, cols, K)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        traction = tan_grade_lattice(heightmap, frame, headings_rad)
        traction += np.float32(robot.rolling_resistance)
        traction *= np.float32(robot.weight_n)
        geared(traction, robot, 1.0)
        x, y = frame.centres()
        return heightmap.layers.on_kinds(traction, robot, x[None, :, None], y[:, None, None])

    def traction_and_std(
        self, heightmap: Heightmap, robot: Robot, frame: GridFrame, headings_rad: FloatArray
    ) -> tuple[NDArray[np.float32], None]:
        """Return `traction_per_m` without an uncertainty.

        Parameters
        ----------
        heightmap, robot, frame, headings_rad : Heightmap, Robot, GridFrame, ndarray
            As `traction_per_m`.

        Returns
        -------
        traction : ndarray of float32, (rows, cols, K)
            Traction demand [J/m].
        std : None
            Eq. 5 has no uncertainty.
        """
        return self.traction_per_m(heightmap, robot, frame, headings_rad), None

    def segment_traction(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> FloatArray:
        """Return m g (mu + tan theta) of 1 m segments.

        Parameters
        ----------
        heightmap : Heightmap
            The ground.
        robot : Robot
            What drives on it.
        x, y : array_like, (n,)
            Centres of the segments [m].
        heading_rad : array_like, (n,)
            Headings [rad].

        Returns
        -------
        ndarray of float64, (n,)
            Traction demand [J/m]; NaN where the map is unknown.
        """
        grade = np.atleast_1d(tan_grade(heightmap, x, y, heading_rad))
        traction = geared(eq5_traction_per_m(robot.weight_n, robot.rolling_resistance, grade), robot, 1.0)
        return heightmap.layers.on_kinds(traction, robot, x, y)

    def segment_traction_and_std(
        self, heightmap: Heightmap, robot: Robot, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike
    ) -> tuple[FloatArray, None]:
        """Return `segment_traction` without an uncertainty.

        Parameters
        ----------
        heightmap, robot, x, y, heading_rad : Heightmap, Robot, array_like
            As `segment_traction`.

        Returns
        -------
        traction : ndarray of float64, (n,)
            Traction demand [J/m].
        std : None
            Eq. 5 has no uncertainty.
        """
        return self.segment_traction(heightmap, robot, x, y, heading_rad), None
