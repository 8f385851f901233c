"""Searches over the moves of a grid: exact, with or without turning, from one place or to all.

`search` finds one path, `fields` the energy to every cell. Both run the kernels of `buckets` and `turning_search` over
the labels of `states`; `stopping` ends them from another thread.
"""
