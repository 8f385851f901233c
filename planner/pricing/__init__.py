"""Prices: the one integrator of a leg's energy, and the prices of all moves of a grid.

`integrator` prices any leg or path, `moves` gives searches their table, `potential` the surface on which climbs cancel.
Everything else asks here what a way costs.
"""
