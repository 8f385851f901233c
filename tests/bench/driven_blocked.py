"""How much of the ground that robots really drove a lattice blocks: `python -m tests.bench.driven_blocked`.

A metre counts as blocked where the cell under its middle may not be driven at the nearest heading bin. Metres that the
map does not know are counted apart: on those no limit was judged.
"""

from __future__ import annotations

import numpy as np

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.frames import TAU
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice
from tests.coverage.real import cuadriga, drive, real_folder

UNJUDGED = (Blocked.OUTSIDE, Blocked.UNKNOWN)
SPACINGS_M = (1.0, 0.5)


def main() -> None:
    """Print the shares."""
    folder = real_folder()
    if folder is None:
        raise SystemExit("there are no real runs here (set JOULEMAP_REAL_DATA to their folder)")
    for name, read in (("cuadriga", cuadriga), ("drive", drive)):
        runs = read(folder)[0]
        for spacing_m in SPACINGS_M:
            counts = np.zeros(len(Blocked), dtype=np.int64)
            for site in runs.sites:
                assert site.new is not None
                lattice = build_lattice(site.heightmap, runs.robot, PhysicsPredictor(), spacing_m=spacing_m)
                row, col = lattice.frame.rowcol(site.new.x, site.new.y)
                row, col = (np.floor(index + 0.5).astype(int) for index in (row, col))
                rows, cols = lattice.frame.shape
                inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
                heading = np.round(site.new.heading_rad[inside] * lattice.headings / TAU).astype(int) % lattice.headings
                codes = lattice.blocked_by_heading()[row[inside], col[inside], heading]
                counts += np.bincount(codes, minlength=counts.size)
                counts[Blocked.OUTSIDE] += np.count_nonzero(~inside)
            judged = counts.sum() - sum(counts[code] for code in UNJUDGED)
            closed = {code.label: counts[code] / judged for code in Blocked if code not in (Blocked.FREE, *UNJUDGED)}
            words = ", ".join(f"{label} {share:.1%}" for label, share in closed.items() if share > 0.0)
            print(
                f"{name}, cells of {spacing_m:g} m: {sum(closed.values()):.1%} of {judged} judged metres are blocked "
                f"({words or 'none'}); {counts.sum() - judged} metres are not judged"
            )


if __name__ == "__main__":
    main()
