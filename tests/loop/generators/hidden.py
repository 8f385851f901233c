"""All kinds of hidden effects by name, the pairs that are tried together, and how one is drawn."""

from __future__ import annotations

import zlib

import numpy as np

from tests.loop.generators.effect import HiddenEffect
from tests.loop.generators.effects_of_conditions import CONDITIONS
from tests.loop.generators.effects_of_logs import LOGS
from tests.loop.generators.effects_of_motion import MOTION
from tests.loop.generators.effects_of_place import PLACE

KINDS: dict[str, type[HiddenEffect]] = {kind.kind: kind for kind in (*MOTION, *PLACE, *CONDITIONS, *LOGS)}

PAIRS = (
    "sliding_scrub+wet_patch",
    "furrows+heater",
    "breeze+yaw_damping",
    "cargo+sliding_scrub",
    "stiff_grease+low_mud",
    "crabbing+heater",
    "late_meter+each_radian",
    "lossy_reverse+fast_drag",
    "soft_tires+wet_patch",
    "washboard+sliding_scrub",
)
"""Pairs of effects in different quantities."""


def drawn_effects(case: str, seed: int, *, size: float = 1.0) -> tuple[HiddenEffect, ...]:
    """Draw the effects of a case.

    Parameters
    ----------
    case : str
        Kinds joined by "+", or "none".
    seed : int
        Of the case. One kind is drawn alike in all cases of a seed.
    size : float
        1 is the usual size of each kind.

    Returns
    -------
    tuple of HiddenEffect
        In the order of `case`.
    """
    names = [] if case == "none" else case.split("+")
    out = []
    for name in names:
        draws = np.random.default_rng([seed, zlib.crc32(name.encode())]).random(4)
        out.append(KINDS[name](size, tuple(draws.tolist())))
    return tuple(out)
