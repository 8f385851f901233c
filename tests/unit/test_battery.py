"""A battery under load: open-circuit voltage behind a resistance, by hand; and batteries that cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.battery import Battery, pack_of
from joulemap.model.errors import InputError
from joulemap.planner.verdict.battery_trace import trace_battery
from joulemap.planner.verdict.budget import judge_course
from joulemap.planner.verdict.energy_distribution import EnergyOdds
from joulemap.planner.verdict.trajectory import Course

FLAT = ((0.0, 10.0), (1.0, 10.0))


def course(*energies_j: float, seconds: float = 2.0) -> Course:
    """Metres of some energy each."""
    energy = np.array(energies_j)
    metres = np.arange(1.0, energy.size + 1.0)
    flat = np.zeros(energy.size)
    return Course(energy, metres, flat + seconds, metres, flat, flat, flat.astype(int), (0.0, 0.0, 0.0), 0.1 * energy)


def test_current_and_voltage_by_hand() -> None:
    """16 W from 10 V behind 1 ohm: 2 A at 8 V (and not 8 A at 2 V). 1 Wh at 10 V is 360 A s; 2 s take 4 of them."""
    battery = Battery(1.0, open_circuit_v=FLAT, resistance_ohm=1.0, cutoff_v=5.0)
    trace = trace_battery(course(32.0), battery, pack_of(battery, 24.0))
    assert trace.voltage_v[0] == pytest.approx(8.0)
    assert trace.charge[0] == pytest.approx(1.0 - 4.0 / 360.0)
    assert trace.lost_j == pytest.approx(2.0**2 * 1.0 * 2.0)
    assert trace.most_power_w[0] == pytest.approx(25.0)  # U^2 / 4 R
    assert trace.overload is None


def test_the_energy_of_the_curve_is_the_capacity() -> None:
    pack = pack_of(Battery(280.0), 28.8)
    charge = np.linspace(0.0, 1.0, 2001)
    assert pack.full_as * np.trapezoid(pack.open_circuit_v(charge), charge) == pytest.approx(280.0 * 3600.0, rel=1e-4)


def test_losses_shorten_the_way() -> None:
    """Half of 100 Wh at a constant 10 V and 16 W behind 1 ohm: 2 A lose a fifth inside."""
    battery = Battery(100.0, charge=0.5, open_circuit_v=FLAT, resistance_ohm=1.0, cutoff_v=5.0)
    verdict = judge_course(course(*[32.0] * 100), battery, nominal_voltage_v=24.0)
    assert verdict.available_j == pytest.approx(0.5 * 100.0 * 3600.0 * 0.8)
    assert verdict.least_voltage_v == pytest.approx(8.0)
    assert verdict.charge_at_end == pytest.approx(0.5 - 400.0 / 36_000.0)


def test_a_load_that_collapses_the_voltage_is_a_no_with_its_place() -> None:
    battery = Battery(100.0, open_circuit_v=FLAT, resistance_ohm=1.0, cutoff_v=6.0)  # 24 W at most
    verdict = judge_course(course(30.0, 30.0, 160.0), battery, nominal_voltage_v=24.0)
    assert (verdict.feasible, verdict.verdict) == (False, "no")
    assert verdict.overload_at is not None
    assert verdict.overload_at.distance_m == pytest.approx(2.0)
    assert judge_course(course(10.0, 10.0, 160.0), battery, nominal_voltage_v=24.0).yes_until_m == 2.0
    assert (verdict.overload_w, verdict.most_power_w) == (pytest.approx(80.0), pytest.approx(24.0))
    assert "the 80 W at 2 m are more than the 24 W that the battery can give there" in verdict.verdict_text
    assert "more than the 24 W" in str(verdict)


def test_a_power_near_the_limit_is_no_yes() -> None:
    """20 W of 21 W, known to a tenth: half a deviation below the limit."""
    battery = Battery(100.0, open_circuit_v=FLAT, resistance_ohm=1.0, cutoff_v=7.0)
    odds = EnergyOdds(np.array([40.0]), np.array([4.0]))
    verdict = judge_course(course(40.0), battery, nominal_voltage_v=24.0, odds=odds)
    assert verdict.probability == pytest.approx(0.6915, abs=1e-3)  # table of the normal distribution
    assert verdict.verdict == "likely"
    limited = Battery(100.0, max_power_w=15.0)
    assert not judge_course(course(40.0), limited, nominal_voltage_v=24.0).feasible


@pytest.mark.parametrize(
    ("top_m", "weight_n", "word"), [(1.0, 98.0, "climb"), (0.2, 98.0, "stretch"), (1.0, None, "stretch")]
)
def test_a_climb_is_where_lifting_takes_most(top_m: float, weight_n: float | None, word: str) -> None:
    """10 kg lifted by 1 m are 98 J of 110 J; by 0.2 m they are 20 J."""
    way = replace(course(10.0, 55.0, 55.0, 10.0), z=np.array([0.0, top_m / 2, top_m, top_m]), weight_n=weight_n)
    said = judge_course(way, Battery(capacity_wh=10.0), nominal_voltage_v=24.0).verdict_text
    assert f"the {word} that begins 1 m along the route and ends at 3 m takes 85 % of the energy" in said


def test_where_and_when_the_reserve_is_touched() -> None:
    """1 Wh is 3600 J, of which half may be used: 1000 J a metre end in the middle of the second one."""
    verdict = judge_course(course(1200.0, 1200.0), Battery(1.0, reserve=0.5), nominal_voltage_v=24.0)
    assert verdict.reserve_at is not None
    assert (verdict.reserve_at.distance_m, verdict.reserve_at.time_s) == (pytest.approx(1.5), pytest.approx(3.0))
    below = judge_course(course(10.0), Battery(1.0, charge=0.1, reserve=0.5), nominal_voltage_v=24.0)
    assert below.verdict == "no"
    assert below.reserve_at is not None
    assert below.reserve_at.distance_m == 0.0
    assert "below the reserve already" in below.verdict_text


def test_cold_and_age_leave_less() -> None:
    cold = Battery(100.0, health=0.8, temperature_c=-10.0, capacity_curve=((-20.0, 0.6), (0.0, 0.8), (20.0, 1.0)))
    assert cold.usable_share == pytest.approx(0.8 * 0.7)
    assert cold.available_j == pytest.approx(0.56 * 360_000.0)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"capacity_wh": 0.0}, "capacity_wh is 0"),
        ({"capacity_wh": -5.0}, "capacity_wh is -5"),
        ({"charge": 1.2}, "charge is 1.2"),
        ({"charge": float("nan")}, "charge is nan"),
        ({"health": 0.0}, "health is 0"),
        ({"temperature_c": -10.0}, "give `capacity_curve`"),
        ({"resistance_ohm": -1.0}, "resistance_ohm is -1"),
        ({"open_circuit_v": [[0.0, 10.0], [0.5, 9.0], [1.0, 12.0]]}, "falls to 9 V"),
        ({"open_circuit_v": [[0.2, 10.0], [1.0, 12.0]]}, "from 0 to"),
        ({"open_circuit_v": [[0.0, 10.0], [0.0, 11.0]]}, "must ascend"),
        ({"open_circuit_v": "12 V"}, "list of 2 to 200 points"),
        ({"capacity_curve": [[0.0, "much"], [20.0, 1.0]]}, "point 0 of capacity_curve"),
        ({"colour": 1}, "unknown 'colour'"),
        ({"charge": "60%"}, "charge is '60%'"),
        ({"capacity_wh": None}, "capacity_wh"),
    ],
)
def test_odd_batteries_are_refused_in_words(values: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Battery.from_mapping({"capacity_wh": 100.0, **values})


def test_a_cutoff_above_the_curve_is_refused() -> None:
    with pytest.raises(InputError, match="highest voltage"):
        pack_of(Battery(100.0, cutoff_v=40.0), 28.8)


def test_an_empty_battery_gives_no_power() -> None:
    verdict = judge_course(course(10.0), Battery(100.0, charge=0.0, resistance_ohm=0.1), nominal_voltage_v=28.8)
    assert (verdict.feasible, verdict.verdict) == (False, "no")
