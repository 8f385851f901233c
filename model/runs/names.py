"""What the name of a logged column says: the quantity, the unit, and which battery, motor or side it belongs to.

A name is divided into words. Its last word that names a quantity says what the column is (`battery_current`,
`current_speed`); the others say of what. Words of a part of the vehicle that is no battery (`motor`, `heater`, `phase`)
and of values that are not measured (`target`, `max`) rule a column out.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import lru_cache
from unicodedata import combining, normalize

from joulemap.model.runs.units import known_unit, unit_in_name


def _set(words: str) -> frozenset[str]:
    return frozenset(words.split())


_WORDS: dict[str, frozenset[str]] = {
    "t": _set(
        "t ts time times timestamp timestamps datetime date stamp clock elapsed seconds secs sec ms millis "
        "milliseconds us micros microseconds ns nanoseconds uptime epoch unix utc interval zeit zeitstempel "
        "uhrzeit tiempo tempo tijd horodatage 日時 時刻 時間 时间"
    ),
    "x": _set("x easting utmx east ost rechtswert"),
    "y": _set("y northing utmy north nord hochwert"),
    "z": _set("z altitude alt elevation elev elv ele height hohe hoehe altitud altezza hoogte 標高 高度 海拔"),
    "lat": _set("lat latitude breite breitengrad latitud latitudine breedtegraad 緯度 纬度"),
    "lon": _set(
        "lon lng long longitude longtitude lange laenge langengrad laengengrad longitud longitudine "
        "lengtegraad 経度 经度"
    ),
    "voltage": _set(
        "voltage voltages volts volt u v vbat vbatt vin vbus ubat ubatt spannung tension voltaje tensione "
        "tensao spanning 電圧 电压"
    ),
    "current": _set(
        "current curr cur amps amp amperes amperage a i ibat ibatt iin ibus strom courant corriente corrente stroom "
        "電流 电流"
    ),
    "power": _set("power watts watt pwr w p pbat leistung puissance potencia potenza vermogen 電力 功率"),
    "energy": _set("energy enrg consumed used consumption drawn discharged wh kwh joules energie energia verbrauch"),
    "charge": _set("charge consumed used consumption drawn discharged ah mah coulombs"),
    "soc": _set("soc percent percentage level charge remaining ladezustand"),
    "distance": _set(
        "distance dist odometer odo mileage trip travelled mile strecke entfernung kilometerstand distanz "
        "distancia distanza afstand 距離 距离 里程"
    ),
    "speed": _set(
        "speed velocity vel spd kmph kmh kph mph mps geschwindigkeit vitesse velocidad velocita velocidade snelheid "
        "速度 車速 车速"
    ),
    "heading": _set("heading yaw course bearing cog hdg"),
}
"""By joulemap's column, the words that name it."""

_OTHER_QUANTITIES = _set(
    "temperature temp rpm erpm torque throttle cadence acceleration accel acc gyro mag pressure humidity duty "
    "resistance capacity slope frequency freq count id index status state mode error fault flag health cycles "
    "efficiency rate pwm steering pedal brake angle orientation twist angular rotation gear satellites sats hdop "
    "quality"
)
"""Words of quantities that a run does not need; as the last word of a name they say that it is no other."""

_ABOUT = _set(
    "gps gnss rtk fix pos pose position odom odometry utm local map world state battery batt bat pack main total "
    "tot sum setup overall all input in bus dc hv supply system sys sensor measured actual value data inverter "
    "vehicle car robot base mcu esc vesc of the and today abs log logged header since start device obd traction "
    "ground location loc geo coordinates point track enhanced is true field msg message data hybrid bms filtered body "
    "tform transform discharge ev batterie bateria akku accu gesamt fahrzeug vehicule 電池 电池 double 总 累计 数据"
)
"""Words that do not change what a column is."""

_NEVER = _set(
    "min max minimum maximum target set setpoint ref reference limit cmd command commanded desired request "
    "requested wanted tx transmitter remote goal home origin waypoint wp dest destination std cov covariance variance "
    "soll sollwert consigne consigna accuracy raw delta avg average mean peak predicted estimate remaining to "
    "empty full per rated nominal"
)
_ELECTRIC = _set(
    "motor phase cell cells heater heating heat ac aircon air conditioning aux auxiliary 12 12v lv charger "
    "charging regen regenerated regenerative brake braking solar pv fan pump servo usb led iq q d axis human "
    "rider crank mechanical mech port driver factor feedforward led light lights wheel gen generator fuel "
    "wifi wlan lte gsm antenna radio rf signal rssi dbm db"
)
_NOT: dict[str, frozenset[str]] = {
    **dict.fromkeys(("voltage", "current", "power"), _NEVER | _ELECTRIC | _set("trip")),
    **dict.fromkeys(
        ("energy", "charge"),
        (_NEVER - _set("remaining")) | _ELECTRIC | _set("charged recovered capacity available recuperated"),
    ),
    **dict.fromkeys(("lat", "lon"), _NEVER | _set("force acceleration accel acc g slip")),
    "soc": (_NEVER - _set("remaining")) | _ELECTRIC | _set("health soh displayed index oil water device phone"),
    "speed": _NEVER | _set("wind motor rotor fan angular rotation engine shaft turn wheel crank"),
    "distance": _NEVER | _set("sensor left range obstacle front rear"),
    "z": _NEVER | _set("change gain loss"),
    "t": _NEVER | _set("remaining charge charging moving stopped left"),
}
SIDES: Mapping[str, str] = {
    "left": "left", "l": "left", "right": "right", "r": "right", "fl": "fl", "fr": "fr", "rl": "rl", "rr": "rr",
    "front": "front", "rear": "rear", "back": "rear", "links": "left", "gauche": "left", "izquierda": "left",
    "sinistra": "left", "rechts": "right", "droite": "right", "derecha": "right", "destra": "right",
}  # fmt: skip
"""Words for a part of the vehicle."""
_PER_WAY = re.compile(r"(?i)h ?/ ?\d* ?(km|mi|m)\b")  # of an energy: a consumption, and no counter
_BY_UNIT = ("voltage", "current", "power", "soc")  # of which the unit of a battery's column leaves one
_UTM = {"e": "easting", "n": "northing"}
_MEANS = (["avg"], ["average"], ["mean"])
_WHEEL = _set("wheel wheels")
_JOINT = _set("joint joints")
_ROLLING = _set("wheel wheels track motor encoder angular drive state states drehzahl rad roue rueda ruota") | _JOINT
_OF_SIDE = {"fl": "left", "rl": "left", "fr": "right", "rr": "right"}
_OF_SIDE |= {word: side for word, side in SIDES.items() if side in ("left", "right")}
_TOTAL = _set("total tot sum setup overall all")
_BATTERY = _set("battery batt bat pack")
_VOCABULARY = frozenset().union(*_WORDS.values(), _OTHER_QUANTITIES, _ABOUT, _NEVER, _ELECTRIC, SIDES)
_QUANTITY_WORDS = frozenset().union(*_WORDS.values(), _OTHER_QUANTITIES)

NEEDED = ("t", "x", "y", "lat", "lon", "voltage", "current", "power", "speed", "distance")
"""What a run may not go without, where a log has it."""

DISCHARGE = "discharge"
"""In the name of a power or a current: it is positive while the battery discharges."""

NAMED, LIKELY, POSSIBLE = 3, 2, 1
"""How surely a name says what a column is: by nothing but words for it, with words about it, with unknown words."""


@dataclass(frozen=True)
class Candidate:
    """A column that may be one of joulemap's."""

    column: str
    unit: str  # as `units.known_unit` returns it; empty where the name says none
    sureness: int  # NAMED, LIKELY or POSSIBLE
    total: int = 0  # how much the name speaks for the whole: 2 where it says a sum, 1 more where it says battery
    instance: str = ""  # number or side that the name has


def candidate(target: str, column: str, unit: str = "") -> Candidate | None:
    """Return what the name of a column says of it.

    Result: None where it is another quantity, of another part, or in a unit of another quantity.
    """
    column_of_two, column = column, re.sub(r" \(\d+\)$|\{[^}]*\}", "", column)  # labels of Prometheus
    stem, in_name = unit_in_name(target, column)
    said = known_unit(target, unit) if unit else None
    if unit and said is None and target not in ("t", "lat", "lon") and is_unit(unit):
        return None
    words = words_of(stem)
    if words[-2:-1] == ["utm"]:  # `utm_e`
        words = [*words[:-1], _UTM.get(words[-1], words[-1])]
    by_unit = bool(in_name) and target in _BY_UNIT and bool(_BATTERY & {*words})  # `bat_mA`, `Battery [%]`
    if in_name is not None and not _WORDS[target] & {*words} and not by_unit:  # `Amps`
        words = words_of(column)
    if unit and words[-1:] in _MEANS:  # a logger that says units means that of its interval: `BattV_Avg`
        words = words[:-1]
    bracket = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", column)
    if bracket is not None and in_name is None and not unit and is_unit(bracket[1]):
        return None  # a unit of another quantity
    if target == "speed" and words[-2:] == ["linear", "x"] and "twist" in words and not _NEVER & {*words}:
        return Candidate(column_of_two, "m/s", LIKELY)  # geometry_msgs/Twist
    heads = [word for word in words if word in _QUANTITY_WORDS and len(word) > 1]
    own = _WORDS[target]
    if not heads and by_unit and all(word in _ABOUT or word.isdigit() for word in words):
        instance = next((word for word in words if word.isdigit()), "")
        return Candidate(column_of_two, said or in_name or "", LIKELY, _whole(words), instance)
    if not heads:  # a single letter is a name only beside words that do not change it
        letters = [word for word in words if word in own]
        if not letters or any(word not in own | _ABOUT and not word.isdigit() for word in words):
            return None
    elif heads[-1] not in own and not (target == "t" and heads[0] in own and in_name is None and heads[-1] in _ABOUT):
        return None
    never = _NOT.get(target, _NEVER) - (_WHEEL if said or in_name else frozenset())  # in rpm a wheel's is none
    if any(word in never for word in words):
        return None
    if target in ("energy", "charge", "speed"):
        in_name = in_name or next((u for word in words if (u := known_unit(target, word))), None)  # watt_hours_used
        if target != "speed" and (not (in_name or said) or _PER_WAY.search(column)):
            return None
    if target == "soc" and not (in_name == "%" or said or {"soc", "percent", "percentage", "level"} & {*words}):
        return None
    if target == "t" and in_name is None:
        in_name = next((u for word in words if (u := known_unit("t", word)) and word not in ("s", "h", "d")), None)
    rest = [word for word in words if word not in own]
    instance = next((SIDES.get(word, word) for word in rest if word.isdigit() or word in SIDES), "")
    unknown = [word for word in rest if word not in _ABOUT and not word.isdigit() and word not in SIDES]
    if (unknown and target in ("x", "y")) or (instance in SIDES.values() and not _BATTERY & {*words}):
        return None
    letter = not heads and target in _BY_UNIT  # `U` may be another thing: `Volt` is surer
    sureness = POSSIBLE if unknown else LIKELY if rest or letter else NAMED
    return Candidate(column_of_two, said or in_name or "", sureness, _whole(words), instance)


def ruled_out(target: str, column: str) -> bool:
    """Return whether the name says another quantity, another part of the vehicle, or a value that is not measured.

    Result: False of a name without a known word.
    """
    words = words_of(unit_in_name(target, column)[0])
    others = (_QUANTITY_WORDS - _WORDS[target]) | _NOT.get(target, _NEVER)
    return any(len(word) > 1 and word in others for word in words)


def part_of(target: str, column: str) -> list[str]:
    """Return the words of a name that do not say the quantity, but of what."""
    return [word for word in words_of(unit_in_name(target, column)[0]) if word not in _WORDS[target]]


def motor_current(column: str) -> Candidate | None:
    """Return the current of a motor or of a side, as its name says; None for any other."""
    return _of_side("current", column, _WORDS["current"], _set("motor drive wheel"), unit_in_name("current", column)[1])


def side_of(column: str) -> str:
    """Return `left` or `right` where the name of a column says it, also of one of several wheels; else empty."""
    return next((_OF_SIDE[word] for word in words_of(column) if word in _OF_SIDE), "")


def wheel_speed(column: str, unit: str = "") -> tuple[str, Candidate] | None:
    """Return which of joulemap's speeds of a side a column is, rolled or turned, as its name says.

    `unit`: where the log gives it separately. Wheels that are joints of a robot turn in rad/s (sensor_msgs/JointState).
    """
    side, joint = side_of(column), bool(_JOINT & {*words_of(column)})
    for target, usual in ((f"speed_{side}", ""), (f"wheel_{side}_rad_s", "rad/s" if joint else "")):
        said = known_unit(target, unit) or unit_in_name(target, column)[1] or usual
        if side and (said or not (joint or target.startswith("wheel"))):
            own = _WORDS["speed"] | (_set("v") | _WHEEL | SIDES.keys() if said else frozenset())
            found = _of_side(target, column, own, _ROLLING, said)
            if found is not None:
                return target, found
    return None


def _of_side(
    target: str, column: str, own: frozenset[str], about: frozenset[str], unit: str | None
) -> Candidate | None:
    words = words_of(unit_in_name(target, column)[0])
    rest = [word for word in words if word not in own]
    instance = next((SIDES.get(word, word) for word in words if word in SIDES or word.isdigit()), "")
    allowed = _ABOUT | about | {*SIDES}
    if len(rest) == len(words) or not instance or any(w not in allowed and not w.isdigit() for w in rest):
        return None
    return Candidate(column, unit or "", LIKELY, 0, instance)


def _whole(words: Collection[str]) -> int:
    return 2 * bool(_TOTAL & {*words}) + bool(_BATTERY & {*words})


def is_unit(word: str) -> bool:
    """Return whether a word, or a number, is a unit of some quantity."""
    others = ("t", "x", "lat", "temperature", "payload", "wheel_left_rad_s")
    return any(known_unit(target, word) is not None for target in (*others, *_WORDS))


@lru_cache(maxsize=20_000)
def words_of(name: str) -> list[str]:
    """Return the words of a name, in lower case."""
    found: list[str] = []
    plain = "".join(letter for letter in normalize("NFKD", name) if not combining(letter))  # Höhe, velocità
    for part in re.findall(r"[^\W_]+", plain):
        pieces = [piece.lower() for piece in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|[^\W\dA-Za-z]+", part)]
        if part.lower() in _VOCABULARY and not all(piece in _VOCABULARY for piece in pieces):
            found.append(part.lower())  # SoC; but curR is the right one
            continue
        for piece in pieces:
            found += _divided(piece)
    return found


def _divided(word: str) -> list[str]:
    """`battvolt` as batt, volt; a word that is not all known words stays whole."""
    if word in _VOCABULARY or len(word) > 40:
        return [word]
    best: list[list[str] | None] = [[], *([None] * len(word))]
    for end in range(1, len(word) + 1):
        for begin in range(end - word.isascii()):  # a sign of Chinese is a word
            before = best[begin]
            if before is not None and word[begin:end] in _VOCABULARY:
                now = best[end]
                if now is None or len(before) + 1 < len(now):
                    best[end] = [*before, word[begin:end]]
    return best[-1] or [word]
