"""Answers for every cell: where a battery lasts to, and the energy to each place.

`reach` needs a battery for that, `reach_map` draws it as areas, `energy_map` is the energy alone.
"""
