"""A calibration from logs whose meter is slower than they are, beside one from the same drives with a fast meter."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from tests.loop import blind
from tests.loop.calibrator import joulemap
from tests.loop.generators.case import make_case
from tests.loop.generators.hidden import drawn_effects
from tests.loop.generators.logs import Log


def read_once_a_second(logs: Sequence[Log], rng: np.random.Generator) -> list[Log]:
    """The same logs, where current and voltage are read once a second and written again until the next reading."""

    def _slow(log: Log) -> Log:
        t = log.numbers["t"]
        reading = np.floor(t - t[0] + rng.uniform()).astype(int)
        first = np.searchsorted(reading, reading)
        return replace(log, numbers=log.numbers | {key: log.numbers[key][first] for key in ("current", "voltage")})

    return [_slow(log) for log in logs]


@pytest.mark.slow
def test_a_slow_meter_costs_little() -> None:
    """The same wet patch is found, and on drives that took no part the error is at most 5 % larger; in steps it was by
    14 %.
    """
    case = make_case(blind.config_of(2), 777_002, drawn_effects("wet_patch", 777_002))
    rng = np.random.default_rng(0)
    fast = joulemap(case.new.site, case.declared, case.new.logs, case.base)
    new, base = (read_once_a_second(logs, rng) for logs in (case.new.logs, case.base))
    slow = joulemap(case.new.site, case.declared, new, base)
    assert [answer.name for answer in slow.answers] == [answer.name for answer in fast.answers]
    errors = [found.error_on(case.test.site, case.test.logs) for found in (fast, slow)]
    assert errors[1] < 1.05 * errors[0]
