"""One validation case: the base model of its site, the calibrator's report, and both compared with the truth."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.field.validation_case import CaseTruth, RunTruth, make_validation_case, write_baseline
from joulemap.model.robot import Robot
from joulemap.model.runs.files import read_segments
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.readers import read_heightmap
from joulemap.model.training import measured_runs as training
from joulemap.model.training.measured_runs import train_on_runs

FloatArray = NDArray[np.float64]

SITES = 4
"""Sites that all cases share, so that few base models serve them."""

SAME = {
    "learned:motor_temperature": {"motor_temperature"},
    "learned:heading": {"heading"},
    "local_friction": {"learned:place"},
    "temperature": {"learned:temperature"},
    "speed": {"learned:speed"},
}
"""Other names under which an effect counts as found: the same quantity without its formula."""

LEAST_GAIN = 0.01
"""Relative error that the true effect explains on the second site; if it is less, no share of it is stated."""


class Calibrator(Protocol):
    """What is tested: it finds effects in runs, and predicts with the model that it wrote."""

    def calibrate(
        self, model: Path, heightmap: Path, runs: Sequence[Path], robot: Path, out: Path, *, truth: CaseTruth
    ) -> dict[str, Any]:
        """The report (its format is that of report.json). Only an oracle looks at the truth.

        The folder of the heightmap contains base/, the runs that the model was made from.
        """

    def predict(self, model: Path, heightmap: Path, segments: Segments, robot: Path, out: Path) -> FloatArray:
        """Energy of segments [J], (n,), from what `calibrate` wrote to `out`."""


@dataclass(frozen=True)
class Fit:
    """A true coefficient and what was reported for it."""

    effect: str
    unit: str
    true: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Outcome:
    """The result of one case. Errors are mean |predicted - measured| / measured per segment.

    new_before, new_after : the report's, on held-out runs. new_clean : the base model on the same drives without any
    effect. other_* : on the second site, with the base model, the calibrated one, the base model plus the true effect,
    and the base model on the drives without effect. floor : of a perfect model on new/. tried_s : of `calibrate` [s].
    covariates : collinear covariates that the model contains in addition to the effects found.
    """

    case: str
    seed: int
    true: tuple[str, ...]
    found: tuple[str, ...]
    new_before: float
    new_after: float
    new_clean: float
    other_before: float
    other_after: float
    other_informed: float
    other_clean: float
    floor: float
    tried_s: float
    fits: tuple[Fit, ...] = ()
    knowable: bool = True
    covariates: tuple[str, ...] = ()

    @property
    def first_right(self) -> bool:
        """The first effect named is a true one; without one, nothing is named."""
        return not self.found if not self.true else bool(self.found) and self.hit(self.found[0])

    @property
    def all_right(self) -> bool:
        return all(any(_same(name, true) for name in self.found) for true in self.true)

    @property
    def false_finds(self) -> tuple[str, ...]:
        return tuple(name for name in self.found if not self.hit(name))

    @property
    def gain_share(self) -> float | None:
        """Share of the possible gain on the second site; None where that is hardly anything, or cannot be known."""
        if not self.knowable:
            return None
        possible = self.other_before - self.other_informed
        return (self.other_before - self.other_after) / possible if possible > LEAST_GAIN else None

    def hit(self, name: str) -> bool:
        return any(_same(name, true) for true in self.true)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Outcome:
        fits = tuple(Fit(**fit) for fit in values["fits"])
        names = {key: tuple(values.get(key, ())) for key in ("true", "found", "covariates")}
        return cls(**{**values, **names, "fits": fits})


def _same(found: str, true: str) -> bool:
    return found == true or found in SAME.get(true, set())


def try_case(case: str, seed: int, calibrator: Calibrator, work: Path) -> Outcome:
    """Make the case `case` (effects joined by "+", or "none") in a folder of `work`, calibrate, compare, clean up."""
    effects = [] if case == "none" else case.split("+")
    site_seed = seed % SITES
    base = base_model(site_seed, work)
    folder = work / "cases" / f"{case}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    truth = make_validation_case(seed, effects, folder / "case", site_seed=site_seed, without_effects=folder / "twins")
    home, robot_file = folder / "case", folder / "case" / "robot.toml"
    new = sorted((home / "new").glob("*.csv"))
    began = time.perf_counter()
    report = calibrator.calibrate(base, home / "dem.tif", new, robot_file, folder / "out", truth=truth)
    tried_s = time.perf_counter() - began
    robot = Robot.from_toml(robot_file)

    columns: set[str] = set()

    def errors(place: str, runs: Path, heightmap: Path) -> tuple[float, float, float]:
        """(base model, calibrated, base model plus the true effect) on all runs of a folder."""
        segments, extra = _segments_with_extra(sorted(runs.glob("*.csv")), place, heightmap, robot, truth)
        predictor, ground = load_predictor(base), read_heightmap(heightmap)
        traction = predictor.segment_traction(ground, robot, segments.x, segments.y, segments.heading_rad)
        before = robot.price_per_m(traction)
        after = calibrator.predict(base, heightmap, segments, robot_file, folder / "out")
        known = np.isfinite(before)
        columns.update(key for key, values in segments.extras.items() if np.isfinite(values).any())
        return (
            _error(before[known], segments.energy_j[known]),
            _error(after[known], segments.energy_j[known]),
            _error((before + extra)[known], segments.energy_j[known]),
        )

    second = home / "other_site" / "dem.tif"
    other_before, other_after, other_informed = errors("other_site", home / "other_site", second)
    new_clean = errors("new", folder / "twins" / "new", home / "dem.tif")[0]
    other_clean = errors("other_site", folder / "twins" / "other_site", second)[0]
    outcome = Outcome(
        case=case,
        seed=seed,
        true=truth.names,
        found=tuple(effect["name"] for effect in report["effects"]),
        covariates=tuple(effect["name"] for effect in report.get("collinear", [])),
        new_before=report["error"]["before"]["mean_relative"],
        new_after=report["error"]["after"]["mean_relative"],
        new_clean=new_clean,
        other_before=other_before,
        other_after=other_after,
        other_informed=other_informed,
        other_clean=other_clean,
        floor=truth.floor_known["new"],
        tried_s=tried_s,
        fits=fits_of(report, truth),
        knowable=all(_NEEDS.get(name, "x") in {*columns, "x"} for name in truth.names),
    )
    shutil.rmtree(folder)
    return outcome


def base_model(site_seed: int, work: Path, *, anew: bool = False) -> Path:
    """The folder of a site's base model, trained once from the shipped one and kept in `work`.

    anew : write the site's runs again, in case the field has changed; a model of the same runs is not trained again.
    """
    folder = work / "sites" / str(site_seed)
    if anew or not (folder / "base").is_dir():
        write_baseline(site_seed, folder)
    files = sorted(folder.glob("base/*.csv"))
    with resources.as_file(resources.files("joulemap.model") / "weights") as shipped:
        digest = hashlib.sha256((shipped / "config.json").read_bytes())
        for file in [Path(training.__file__), folder / "dem.tif", folder / "robot.toml", *files]:
            digest.update(file.read_bytes())
        out = work / "models" / digest.hexdigest()[:16]
        if not (out / "config.json").is_file():
            ground, robot = read_heightmap(folder / "dem.tif"), Robot.from_toml(folder / "robot.toml")
            train_on_runs(ground, robot, files, out=out, start_from=shipped)
    return out


def fits_of(report: dict[str, Any], truth: CaseTruth) -> tuple[Fit, ...]:
    """Every true coefficient that the report states in the same unit, under the effect's own name."""
    found = []
    for known in truth.coefficients:
        for effect in report["effects"]:
            stated = [c for c in effect["coefficients"] if c["unit"] == known.unit]
            if effect["name"] == known.effect and len(stated) == 1 and known.effect not in _NO_ONE_FORM:
                low, high = stated[0]["ci95"]
                found.append(Fit(known.effect, known.unit, known.value, stated[0]["value"], low, high))
    return tuple(found)


_NO_ONE_FORM = {"terrain_class", "local_friction", "cross_slope", "acceleration", "speed", "temperature", "drift"}
"""Effects whose coefficient depends on the form that is chosen: there is no true value to cover."""


_NEEDS = {"wind": "wind_speed", "payload": "payload", "local_friction": "nothing that is logged"}
"""The column a log must have for an effect to be known elsewhere."""


def extra_energy(truth: RunTruth, segments: Segments) -> FloatArray:
    """What the true effects took in each segment of one run [J], (n,)."""
    extra = truth.known_j - truth.without_j
    ends = segments.t0 + segments.duration_s
    return np.interp(ends, truth.t, extra) - np.interp(segments.t0, truth.t, extra)


def _segments_with_extra(
    files: Sequence[Path], place: str, heightmap: Path, robot: Robot, truth: CaseTruth
) -> tuple[Segments, FloatArray]:
    _, segments = read_segments(files, robot, crs=read_heightmap(heightmap).frame.crs)
    extra = np.zeros(len(segments))
    for k, name in enumerate(segments.runs):
        mine = segments.run == k
        extra[mine] = extra_energy(truth.runs[f"{place}/{name}"], segments.take(mine))
    return segments, extra


def _error(predicted: FloatArray, measured: FloatArray) -> float:
    return float(np.mean(np.abs(predicted - measured) / measured))


def append_outcome(path: Path, outcome: Outcome) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(outcome.as_dict()) + "\n")


def read_outcomes(path: Path) -> list[Outcome]:
    if not path.is_file():
        return []
    return [Outcome.from_dict(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
