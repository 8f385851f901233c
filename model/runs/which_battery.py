"""Which columns are the power, the voltage and the current of the battery, or of several in parallel.

Where names leave several, the pair whose product is the power decides, then the names of the parts that they are of.
Numbered pairs of a voltage and a current are batteries in parallel, whose powers add.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from joulemap.model.runs.agreement import disagreement
from joulemap.model.runs.candidates import CONFIDENCE, Recognised, candidates_of, surest
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import Source, replaced
from joulemap.model.runs.names import LIKELY, Candidate, motor_current, part_of
from joulemap.model.runs.table import FloatArray
from joulemap.model.runs.units import unit_in_name

_AGREE = 0.2  # of power with voltage times current, in the median
_Tied = dict[str, list[Candidate]]


def choose_battery(stream: Stream, mapping: Mapping[str, str], found: Recognised) -> None:
    """Choose what power is made of."""
    numbers, taken = stream.numbers, found.taken
    of = {
        key: [] if replaced(key, mapping) else candidates_of(key, stream, taken)
        for key in ("voltage", "current", "power")
    }
    parts = [each for each in numbers if each.startswith("current_") or each in ("left_current", "right_current")]
    if len(parts) > 1:
        of["current"] = [
            each for each in of["current"] if each.sureness >= LIKELY and not _is_motor_a(each.column, parts)
        ]
    if not replaced("current", mapping) and not of["current"]:
        _take_motors(stream, taken, found)
    tied = {key: surest(each, numbers) for key, each in of.items()}
    amps = {each.instance for each in tied["current"]} - {""}
    volts = [each for each in of["voltage"] if each.instance in amps]  # batteries in parallel have the same
    if len(amps) == len(tied["current"]) > 1 and {each.instance for each in volts} == amps and len(volts) == len(amps):
        tied["voltage"] = volts
    several = len(tied["voltage"]) > 1 or len(tied["current"]) > 1
    if several and not _narrowed(tied, numbers):
        _take_packs(tied, found)
    for key, each in tied.items():
        if key in found.chosen or not each or (found.packs and key in ("voltage", "current")):
            continue
        in_parallel = key == "power" and len({one.instance for one in each} - {""}) == len(each)
        if len(each) == 1 or in_parallel:
            found.take(key, each)
        else:
            found.ask(key, each)


def _is_motor_a(column: str, others: Collection[str]) -> bool:
    """Whether `current_a` is that of a motor a, beside `current_b`, and no current in A."""
    return column.lower() == "current_a" and any(other.lower() == "current_b" for other in others)


def _take_motors(stream: Stream, taken: Collection[str], found: Recognised) -> None:
    """The currents of motors, where there is none of the battery."""
    own = {column: unit_in_name("current", column) for column in stream.numbers if column.startswith("current_")}
    for column, (stem, unit) in own.items():  # `current_left_mA`: what the name ends with is no motor
        if unit is not None and stem not in stream.numbers and not _is_motor_a(column, own):
            found.chosen[stem] = Source(((1, column),), unit)
    motors = [each for column in stream.numbers if column not in taken and (each := motor_current(column)) is not None]
    if not own and len(motors) > 1 and len({each.instance for each in motors}) == len(motors):
        for each in motors:
            found.take(f"current_{each.instance}", [each])


def _narrowed(tied: _Tied, numbers: Mapping[str, FloatArray]) -> bool:
    """Leave one voltage and one current: those whose product is the power; or the only two whose names say the same
    part, PackVolt and PackAmps beside BatteryVolt. Result: whether there are such.
    """
    pairs = [(v, i) for v in tied["voltage"] for i in tied["current"]]
    if len(tied["power"]) == 1 and pairs:
        power = numbers[tied["power"][0].column]
        off = {pair: disagreement(power, numbers[pair[0].column] * numbers[pair[1].column]) for pair in pairs}
        best = min(pairs, key=lambda pair: off[pair])
        if off[best] <= _AGREE:
            tied["voltage"], tied["current"] = [best[0]], [best[1]]
            return True
    alike = [(v, i) for v, i in pairs if part_of("voltage", v.column) == part_of("current", i.column)]
    if len(alike) != 1 or min(len(tied["voltage"]), len(tied["current"])) > 1:
        return False
    tied["voltage"], tied["current"] = ([each] for each in alike[0])
    return True


def _take_packs(tied: _Tied, found: Recognised) -> None:
    """Pairs of a voltage and a current with the same number."""
    volts, amps = ({each.instance: each for each in tied[key]} for key in ("voltage", "current"))
    same = amps.keys() & volts.keys()
    if len(amps) < 2 or len(amps) != len(tied["current"]) or (len(volts) > 1 and len(same) != len(amps)):
        return
    only = next(iter(volts.values()), None) if len(volts) < 2 else None
    pairs = [(volts.get(key, only), amp) for key, amp in amps.items()]
    if "" in amps or any(volt is None for volt, _ in pairs):
        return
    found.packs = [tuple(Source(((1, each.column),), each.unit) for each in pair if each) for pair in pairs]  # type: ignore[misc]
    found.confidence["power"] = CONFIDENCE[min(each.sureness for each in amps.values())]
