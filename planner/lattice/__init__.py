"""The cost lattice: what driving costs at every cell and heading, what is blocked and why.

`CostLattice` is handed to everything else. It is made by `build`, written by `folder` and read by `loading` (with
checksums; `layout` says what lies where), and `avoid` blocks areas of it. A map too large for memory is a
`stored_lattice`, read tile by tile.
"""

from joulemap.planner.lattice.cost_lattice import Blocked, CostLattice

__all__ = ["Blocked", "CostLattice"]
