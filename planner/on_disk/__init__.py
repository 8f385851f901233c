"""The search of a map that does not fit in memory: tile by tile, led by a coarse map and its lower bounds.

`tiled_search` finds the path over grid moves; a `strip` holds the cells around it, for what follows.
"""
