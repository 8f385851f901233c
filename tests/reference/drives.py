"""Made-up drives: wandering runs with noise like that of real ones, to which a test adds the effect it asks about."""

import numpy as np
from scipy.signal import lfilter

from joulemap.model.loop.calibration import calibrate
from joulemap.model.loop.drive import Drive
from joulemap.model.loop.residual import residuals_of
from joulemap.model.robot import Robot
from joulemap.model.runs.track import TURN_LIMITS_RADPS

ROBOT = Robot(mass_kg=40.0, idle_power_w=12.0, speed_mps=0.5)


def smooth_noise(rng, n, length=8.0):
    rough = rng.standard_normal(n + 60)
    return lfilter([1.0], [1.0, -np.exp(-1.0 / length)], rough)[60:] * np.sqrt(1.0 - np.exp(-2.0 / length))


def made_up(rng, *, runs=6, each=120, heading=None) -> Drive:
    """A drive that wanders over 50 x 50 m with a turn now and then."""
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
                "traction_per_m": ROBOT.weight_n * (0.08 + grade),
                "turned_rad": turned,
                "turned_abs_rad": np.abs(turned),
                "gentle_turn_rad": np.stack([np.minimum(np.abs(turned), 2.0 * r) for r in TURN_LIMITS_RADPS], axis=1),
                "gained_m2ps2": 0.01 * rng.random(each),
                "grade": grade,
                "grades": np.repeat(grade[:, None], 5, axis=1),
                "cross": 0.04 * smooth_noise(rng, each),
                "cross_abs": 0.03 * np.abs(smooth_noise(rng, each)),
                "cross_sq": 0.001 * smooth_noise(rng, each) ** 2,
                "roughness_m": 0.01 * np.exp(0.3 * smooth_noise(rng, each)),
                "elevation_m": smooth_noise(rng, each),
                "hollow_m": 0.05 * smooth_noise(rng, each),
                "since_s": clock - clock[0],
                "driven_m": np.arange(each) + 1.0,
                "clock_s": clock,
                "temperature": 15.0 + run + 0.3 * smooth_noise(rng, each),
            }
        )
    columns = {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}
    logged = {"temperature": columns.pop("temperature")}
    return Drive(robot=ROBOT, **columns, columns=logged, runs=tuple(f"run{k}@0" for k in range(runs)))


def noisy(rng, drive, extra=0.0, share=0.07):
    """Measured energies: noise is a share, a part of it alike in neighbours and 1 % alike in whole runs."""
    n = len(drive)
    levels = 0.01 * rng.standard_normal(drive.run.max() + 1)
    noise = share * (0.8 * rng.standard_normal(n) + 0.6 * smooth_noise(rng, n)) + levels[drive.run]
    return (drive.predicted + extra) * (1.0 + noise)


def found_in(drive, measured, **options):
    names = tuple(f"run{k}" for k in range(int(drive.run.max()) + 1))
    return calibrate(residuals_of(drive, measured, names, charge=False), **options)


def wheel_logs() -> dict[str, str]:
    """Logs in CSV of wheel speeds and currents by file name: straight on and turning, on two grounds in turn. Per metre
    of 2 s ice takes 3 A less than loam; a turn of 1 rad (track 1 m) takes 15 A more on loam, 1 A on ice."""
    rng = np.random.default_rng(2)
    logs = {}
    for number in range(8):
        ground = ("ice", "sandy_loam")[number % 2]
        speed = 0.5 + 0.1 * np.sin(np.arange(900) / rng.uniform(40, 60))
        turn = np.repeat(rng.choice([0.0, 0.25], 18, p=[0.7, 0.3]), 50)  # half the difference of the sides
        amps = {"ice": 4.0 + 4.0 * turn, "sandy_loam": 7.0 + 60.0 * turn}[ground] * (speed / 0.5)
        amps *= 1.0 + 0.1 * rng.standard_normal(900)
        rows = zip(np.arange(900) / 6.5, amps / 2, -amps / 2, speed + turn, speed - turn, strict=True)
        lines = ["time,curL,curR,velL,velR", *(",".join(map(str, row)) for row in rows)]
        logs[f"{ground}_{number:02d}.csv"] = "\n".join(lines)
    return logs
