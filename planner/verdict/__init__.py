"""Whether the battery lasts: energy against charge along a trajectory, with its distribution.

`budget` gives the verdict, `battery_trace` the charge along the way and `energy_distribution` the odds.
"""
