"""Draws docs/pictures/any-angle.png: the region of one question, and its path before and after its vertices moved.

python -m tests.docs.any_angle_picture
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import CLOSED_PARTS, best_path
from joulemap.planner.any_angle.chords import chords_of
from joulemap.planner.any_angle.line_points import cheapest_over_line_points
from joulemap.planner.any_angle.region import region_between
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.pricing.integrator import driven_prices, margin_cells
from joulemap.planner.pricing.moves import move_table, with_margin
from tests.bench.maps import terrain

FILE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "any-angle.png"
START, GOAL = np.array([8.0, 6.0]), np.array([50.0, 52.0])
ZOOM = 20, 30, 22, 35  # rows and columns of the right half


def main() -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    robot = Robot(max_grade_deg=14.0, max_cross_slope_deg=12.0)
    lattice = build_lattice(terrain(60, 0.5), robot, load_predictor("physics"))
    table = with_margin(move_table(lattice, neighbours=32), margin_cells(lattice))
    region = region_between(lattice, table, START, GOAL)
    assert region.cells is not None
    typical_j = region.grid.energy_j / 60.0
    rough = cheapest_over_line_points(
        lattice, driven_prices(lattice, typical_j), region.cells, START, GOAL, parts=CLOSED_PARTS, typical_j=typical_j
    )
    path = best_path(lattice, table, START, GOAL).points
    closed = (lattice.blocked_by_heading() != Blocked.FREE).mean(axis=2)

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), constrained_layout=True)
    for axes in (left, right):
        axes.imshow(closed, cmap="Greys", vmin=0.0, vmax=1.6, interpolation="nearest")
        axes.set_aspect("equal")
    left.imshow(
        np.where(region.cells, 1.0, np.nan), cmap="Blues", vmin=0.0, vmax=2.5, alpha=0.7, interpolation="nearest"
    )
    left.plot(region.grid.points[:, 1], region.grid.points[:, 0], color="#b3261e", lw=1.4, label="cheapest grid path")
    left.plot(path[:, 1], path[:, 0], color="#0b57d0", lw=1.8, label="path")
    left.add_patch(
        plt.Rectangle((ZOOM[2] - 0.5, ZOOM[0] - 0.5), ZOOM[3] - ZOOM[2], ZOOM[1] - ZOOM[0], fill=False, ec="black")
    )
    left.set_title("region (blue); darker: more headings are closed", fontsize=10)
    places = chords_of(CLOSED_PARTS).places
    cells = np.argwhere(region.cells)
    points = (cells[:, None, :] + places[None, :, :]).reshape(-1, 2)
    inside = (points >= [ZOOM[0] - 0.5, ZOOM[2] - 0.5]).all(axis=1) & (points <= [ZOOM[1] - 0.5, ZOOM[3] - 0.5]).all(
        axis=1
    )
    right.scatter(points[inside, 1], points[inside, 0], s=2.0, color="#5b7fb8", label="line points")
    right.plot(rough[:, 1], rough[:, 0], color="#b3261e", lw=1.2, marker="o", ms=2.5, label="cheapest over line points")
    right.plot(path[:, 1], path[:, 0], color="#0b57d0", lw=2.0, label="after its vertices moved")
    right.set_xlim(ZOOM[2] - 0.5, ZOOM[3] - 0.5)
    right.set_ylim(ZOOM[1] - 0.5, ZOOM[0] - 0.5)
    right.set_title("line points, and the path before and after", fontsize=10)
    for axes in (left, right):
        axes.legend(fontsize=8, loc="upper right" if axes is left else "lower left")
        axes.set_xlabel("column")
        axes.set_ylabel("row")
    figure.savefig(FILE, dpi=110)
    print(f"written: {FILE}")


if __name__ == "__main__":
    main()
