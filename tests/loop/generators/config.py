"""Settings of the generators. Everything that a case is made of is drawn from these by a seeded generator.

The ranges are those of small ground robots; they are settings of a test, not measurements. Ranges are (low, high) and
are drawn uniformly.
"""

from __future__ import annotations

from dataclasses import dataclass, field

Range = tuple[float, float]


@dataclass(frozen=True)
class SiteConfig:
    """A random site: heights are a sum of plane cosine waves of random direction, length and phase.

    Attributes
    ----------
    width_m, height_m : float
        Size to the east and to the north [m].
    cell_m : float
        Side of a cell of the heightmap [m].
    grade_rms : float
        Root mean square of the slope's tangent: about 0.01 is flat, 0.07 hilly.
    wave_m : (float, float)
        Shortest and longest wave [m]. Waves far longer than a robot, so that no bump hides within a metre.
    waves : int
        Number of waves.
    """

    width_m: float = 60.0
    height_m: float = 40.0
    cell_m: float = 0.2
    grade_rms: float = 0.07
    wave_m: Range = (12.0, 60.0)
    waves: int = 40


HILLY = SiteConfig()
FLAT = SiteConfig(grade_rms=0.01)


@dataclass(frozen=True)
class RobotConfig:
    """A random robot, and how well its owner knows it.

    Attributes
    ----------
    mass_kg, rolling_resistance, idle_power_w, speed_mps, wheelbase_m, voltage_v : (float, float)
        Ranges. The rolling resistance is that of the ground contact alone.
    efficiency : (float, float)
        Constant efficiency from the battery to the ground.
    regeneration : (float, float)
        Share of a descent's energy that returns to the battery. Half of the robots have none.
    declared_off : float
        Relative size of the error in the declared mass, rolling resistance and idle power; each has a random sign.
    """

    mass_kg: Range = (25.0, 120.0)
    rolling_resistance: Range = (0.04, 0.10)
    idle_power_w: Range = (8.0, 25.0)
    speed_mps: Range = (0.4, 0.8)
    wheelbase_m: Range = (0.4, 0.8)
    voltage_v: Range = (24.0, 48.0)
    efficiency: Range = (0.70, 0.92)
    regeneration: Range = (0.1, 0.4)
    declared_off: float = 0.0


@dataclass(frozen=True)
class DriveConfig:
    """How runs are driven: from one random waypoint to the next, with curves, stops and changes of speed.

    Attributes
    ----------
    length_m : float
        Length of a run along the track [m].
    rate_hz : float
        Rate of the log [Hz].
    leg_m : (float, float)
        Distance from one waypoint to the next [m].
    radius_m : (float, float)
        Smallest radius of curves, drawn for every leg [m].
    weave_per_m : float
        Largest curvature of weaving, drawn for every leg from 0 [1/m].
    speed_factor : (float, float)
        Speed of a leg in cruising speeds.
    acceleration_mps2 : float
        Speeding up and slowing down [m/s^2].
    stops_per_100m : float
        Mean number of stops, 3 to 8 s each.
    reverse_share : float
        Share of legs that are driven backwards.
    margin_m : float
        Waypoints keep this distance from the border of the site [m].
    """

    length_m: float = 300.0
    rate_hz: float = 10.0
    leg_m: Range = (6.0, 25.0)
    radius_m: Range = (0.7, 2.5)
    weave_per_m: float = 0.3
    speed_factor: Range = (0.7, 1.15)
    acceleration_mps2: float = 0.2
    stops_per_100m: float = 0.5
    reverse_share: float = 0.0
    margin_m: float = 4.0


@dataclass(frozen=True)
class LogConfig:
    """What the logger does to the truth.

    Attributes
    ----------
    gps_sd_m : (float, float)
        Standard deviation of each logged coordinate, white, drawn for every run [m].
    shift_m : (float, float)
        By how much all logged positions miss the map to the east and to the north [m].
    lag_s : float
        Delay of the ammeter [s].
    current_sd : float
        White relative noise of a single reading of the current.
    innocent : bool
        Whether the log has columns that have nothing to do with the energy, see `logs.INNOCENT`.
    """

    gps_sd_m: Range = (0.01, 0.02)
    shift_m: Range = (0.0, 0.0)
    lag_s: float = 0.0
    current_sd: float = 0.01
    innocent: bool = True


@dataclass(frozen=True)
class NoiseConfig:
    """What multiplies the power along the track; a value holds for one metre, everything adds up.

    Attributes
    ----------
    run_sd : float
        Of the level of a run.
    white_sd : float
        Of each metre, independent.
    freedom : float
        Degrees of freedom of Student's t for the white part, scaled to `white_sd`; infinite is normal.
    serial_sd, serial : float
        Stationary AR(1) along the track: its standard deviation, and its correlation from one metre to the next.
    walk_sd : float
        Step of a random walk along the track [1/sqrt(m)].
    region_factor : float
        By how much larger the white part is in a region (a half of the site, cut in a random direction).
    hit_share : float
        Share of metres with a one-off disturbance.
    hit : (float, float)
        What a disturbance adds to the factor.
    """

    run_sd: float = 0.02
    white_sd: float = 0.05
    freedom: float = float("inf")
    serial_sd: float = 0.0
    serial: float = 0.95
    walk_sd: float = 0.0
    region_factor: float = 1.0
    hit_share: float = 0.0
    hit: Range = (0.3, 1.0)


@dataclass(frozen=True)
class WeatherConfig:
    """The weather of a day and of its runs.

    Attributes
    ----------
    day_degc : (float, float)
        Mean temperature of a day [degC].
    run_sd_degc : float
        Of a run about its day [degC].
    drift_degc_per_h : float
        Change within a run, with a random sign [degC/h].
    wind_mps : (float, float)
        Wind speed of a run [m/s]. It costs nothing unless an effect says so.
    wind_logged : bool
        Whether the log has the wind.
    new_degc : (float, float), optional
        Instead of a day's mean: temperature of each new run, evenly spread and in random order [degC].
    cargo_share : float
        Largest load of the new runs in robot masses, evenly spread and in random order; the log has it in kg.
    """

    day_degc: Range = (2.0, 20.0)
    run_sd_degc: float = 3.0
    drift_degc_per_h: float = 2.0
    wind_mps: Range = (0.0, 6.0)
    wind_logged: bool = True
    new_degc: Range | None = None
    cargo_share: float = 0.0


@dataclass(frozen=True)
class CaseConfig:
    """One case: a site, a robot, a day of baseline runs, a day of new runs, and runs on another site.

    Attributes
    ----------
    new_runs, base_runs, other_runs : int
        Numbers of runs; `base_runs` and `other_runs` may be 0.
    test_runs : int
        Runs of the new day that take no part in the calibration, spread evenly over the day.
    inertia : bool
        Whether speeding up takes kinetic energy, as it does. Without it nothing depends on the acceleration.
    """

    site: SiteConfig = field(default_factory=SiteConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    log: LogConfig = field(default_factory=LogConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    weather: WeatherConfig = field(default_factory=WeatherConfig)
    new_runs: int = 6
    base_runs: int = 6
    other_runs: int = 0
    test_runs: int = 0
    inertia: bool = True
