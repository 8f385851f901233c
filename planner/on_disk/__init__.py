"""The search of a map that does not fit in memory: tile by tile, led by a coarse map and its lower bounds.

`tiled_table` has the moves that a search reaches; a `strip` holds the cells around its path, for what follows.
"""
