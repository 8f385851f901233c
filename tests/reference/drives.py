"""Made-up drives: wandering runs with noise like that of real ones, to which a test adds the effect it asks about."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from joulemap.model.loop.calibrate import Calibration, calibrate
from joulemap.model.robot import Robot
from joulemap.model.runs.features import Features
from joulemap.model.runs.residuals import Residuals, residuals_of

ROBOT = Robot(mass_kg=40.0, idle_power_w=12.0, speed_mps=0.5, rolling_resistance=0.08)


def smooth_noise(rng, n, length=8.0):
    rough = rng.standard_normal(n + 60)
    return lfilter([1.0], [1.0, -np.exp(-1.0 / length)], rough)[60:] * np.sqrt(1.0 - np.exp(-2.0 / length))


def made_up(rng, *, runs=6, each=120, heading=None) -> Features:
    """Rows of drives that wander over 50 x 50 m with a turn now and then."""
    parts = []
    for run in range(runs):
        turned = np.where(rng.random(each) < 0.2, rng.normal(0.0, 0.6, each), rng.normal(0.0, 0.01, each))
        way = np.cumsum(turned) + rng.uniform(0, 6.3) if heading is None else np.full(each, heading)
        duration = 2.0 * np.exp(0.05 * smooth_noise(rng, each)) + 0.6 * np.abs(turned)
        clock = 3600.0 * run + np.cumsum(duration)
        grade = 0.05 * smooth_noise(rng, each)
        parts.append(
            {
                "run": np.full(each, run),
                "x": 25.0 + 15.0 * smooth_noise(rng, each),
                "heading_rad": way % 6.2832,
                "y": 25.0 + 15.0 * smooth_noise(rng, each),
                "length_m": np.ones(each),
                "duration_s": duration,
                "traction_per_m": ROBOT.weight_n * (ROBOT.rolling_resistance + grade),
                "turned_rad": turned,
                "turned_abs_rad": np.abs(turned),
                "gained_m2ps2": 0.01 * rng.random(each),
                "kinetic_m2ps2": 0.01 * rng.standard_normal(each),
                "grade": grade,
                "grades": np.repeat(grade[:, None], 5, axis=1),
                "grade_east": 0.01 * smooth_noise(rng, each),
                "grade_north": 0.01 * smooth_noise(rng, each),
                "cross_abs": 0.03 * np.abs(smooth_noise(rng, each)),
                "cross_sq": 0.001 * smooth_noise(rng, each) ** 2,
                "roughness_m": 0.01 * np.exp(0.3 * smooth_noise(rng, each)),
                "elevation_m": smooth_noise(rng, each),
                "position_index_m": 0.05 * smooth_noise(rng, each),
                "since_s": clock - clock[0],
                "driven_m": np.arange(each) + 1.0,
                "clock_s": clock,
                "temperature": 15.0 + run + 0.3 * smooth_noise(rng, each),
            }
        )
    columns = {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}
    logged = {"temperature": columns.pop("temperature")}
    return Features(robot=ROBOT, **columns, columns=logged, runs=tuple(f"run{k}@0" for k in range(runs)))


def stops(rng, rows, each=4) -> Features:
    """Stationary intervals of 20 to 170 s, `each` in every run, on its metres."""
    run_ends = np.flatnonzero(np.diff(rows.run, append=-1)) + 1
    where = np.concatenate([rng.integers(a, b, each) for a, b in zip([0, *run_ends[:-1]], run_ends, strict=True)])
    still = rows.take(where)
    moved = ["length_m", "turned_rad", "turned_abs_rad", "gained_m2ps2", "kinetic_m2ps2"]
    shape = ["grade", "grades", "grade_east", "grade_north", "cross_abs", "cross_sq", "roughness_m"]
    nothing = {name: np.zeros_like(getattr(still, name)) for name in (*moved, *shape)}
    return replace(still, duration_s=rng.uniform(20.0, 170.0, len(still)), **nothing)


def even(n=1, **changed) -> Features:
    """Metres of 2 s straight to the north on level ground, one after the other in one run; `changed` are columns of
    numbers or fields of `Features`."""
    fields = {
        "run": np.zeros(n, dtype=np.int64),
        "x": np.zeros(n),
        "y": np.arange(n) + 0.5,
        "heading_rad": np.zeros(n),
        "length_m": np.ones(n),
        "duration_s": np.full(n, 2.0),
        "traction_per_m": np.full(n, ROBOT.rolling_resistance * ROBOT.weight_n),
        "grades": np.zeros((n, 5)),
        "since_s": 2.0 * np.arange(n),
        "driven_m": np.arange(n) + 1.0,
        "clock_s": 2.0 * np.arange(n),
    }
    for name in ("turned_rad", "turned_abs_rad", "gained_m2ps2", "kinetic_m2ps2", "grade", "grade_east", "grade_north"):
        fields[name] = np.zeros(n)
    for name in ("cross_abs", "cross_sq", "roughness_m", "elevation_m", "position_index_m"):
        fields[name] = np.zeros(n)
    given = {key: np.asarray(v, dtype=np.float64) if isinstance(v, list | float) else v for key, v in changed.items()}
    return Features(robot=ROBOT, runs=("run0@0",), **fields | given)


def noisy(rng, rows, extra=0.0, share=0.07):
    """Measured energies: noise is a share, a part of it alike in neighbours and 1 % alike in whole runs."""
    n = len(rows)
    levels = 0.01 * rng.standard_normal(rows.run.max() + 1)
    noise = share * (0.8 * rng.standard_normal(n) + 0.6 * smooth_noise(rng, n)) + levels[rows.run]
    return (rows.predicted + extra) * (1.0 + noise)


def measured_on(rows, energy, *, charge=False) -> Residuals:
    """Residuals of rows; the runs are called run0, run1 and so on."""
    names = tuple(f"run{k}" for k in range(int(rows.run.max()) + 1))
    return residuals_of(rows, energy, names, charge=charge)[0]


def found_in(rows, energy, *, cross_validate=False, **options) -> Calibration:
    """A calibration. Its errors are those of the fit, which takes a tenth of the time."""
    return calibrate(measured_on(rows, energy), cross_validate=cross_validate, **options)


def wheel_logs(runs=8) -> dict[str, str]:
    """Logs in CSV of wheel speeds and currents by file name: straight on and turning, on two grounds in turn. The
    current goes with the torque, whatever the speed: straight ahead 4 A on ice and 7 A on loam; a curve of 1 rad/m
    (track 1 m) takes 1 A more on ice, 15 A on loam."""
    rng = np.random.default_rng(2)
    logs = {}
    for number in range(runs):
        ground = ("ice", "sandy_loam")[number % 2]
        speed = 0.5 + 0.1 * np.sin(np.arange(900) / rng.uniform(40, 60))
        turn = np.repeat(rng.choice([0.0, 0.25], 18, p=[0.7, 0.3]), 50)  # half the difference of the sides
        curvature = 2.0 * turn / speed
        amps = {"ice": 4.0 + curvature, "sandy_loam": 7.0 + 15.0 * curvature}[ground]
        amps *= 1.0 + 0.1 * rng.standard_normal(900)
        rows = zip(np.arange(900) / 6.5, amps / 2, -amps / 2, speed + turn, speed - turn, strict=True)
        lines = ["time,curL,curR,velL,velR", *(",".join(map(str, row)) for row in rows)]
        logs[f"{ground}_{number:02d}.csv"] = "\n".join(lines)
    return logs


def unlike_logs() -> dict[str, str]:
    """Logs as those of `wheel_logs`, straight on at one speed, of four runs whose currents have nothing in common."""
    rng = np.random.default_rng(3)
    logs = {}
    for number, amps in enumerate((3.0, 24.0, 6.0, 12.0)):
        drawn = amps * (1.0 + 0.1 * rng.standard_normal(300))
        lines = (f"{k / 6.5},{current / 2},{-current / 2},0.5,0.5" for k, current in enumerate(drawn))
        logs[f"run_{number}.csv"] = "\n".join(["time,curL,curR,velL,velR", *lines])
    return logs
