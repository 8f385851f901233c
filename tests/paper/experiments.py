"""The paper's section V, experiment by experiment: every method predicts the same measured segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.predictor import Predictor, load_predictor
from joulemap.model.runs.segments import concatenate_segments
from tests.paper import networks
from tests.paper.baselines import friction_map, global_friction, local_friction, shape_ridge
from tests.paper.compact import trained_compact
from tests.paper.fieldwork import make_field, more_examples
from tests.paper.measured import Measured
from tests.paper.profiles import STRATEGIES, Profile
from tests.paper.setting import ROWS, Field, Scores, Setting

FloatArray = NDArray[np.float64]


_BASELINES = (("physics", global_friction), ("gp", friction_map), ("ridge", shape_ridge))
_PAPER_SHARE = 3  # a third of a site is trained on


def baselines(setting: Setting, seed: int) -> Scores:
    """Judge physics, friction as a Gaussian process, the regression on shape, and the noise floor on all test sets."""
    field, scores = Field(setting, seed), Scores()
    for row in ROWS:
        test = field.test(row)
        if row != "V-E shifted":
            scores.add("noise_floor", row, test.explained_j, test)
    for method, fit in _BASELINES:
        grass = fit(field.west("a_lawnmower"), field.robot)
        for row in ("V-A", "V-B", "V-C", "V-E"):
            scores.add(method, row, grass(field.test(row)), field.test(row))
        scores.add_shifted(method, scores.arrays[f"{method}/V-E"], field.test("V-E"))
        dirt = fit(field.west("dirt_lawnmower"), field.robot)
        for row in ("V-E rest", "V-E other"):
            scores.add(method, row, dirt(field.test(row)), field.test(row))
    near = field.test("V-D")
    scores.add("physics", "V-D", local_friction(near, field.robot), near)
    return scores


def compact(setting: Setting, seed: int) -> Scores:
    """Train the compact network from the shipped weights and from scratch, on grass and then on dirt."""
    field, scores = Field(setting, seed), Scores()
    for method, start in (("compact", networks.SHIPPED), ("compact_scratch", None)):
        here = setting.model(method, seed)
        trained = trained_compact(
            field.west("a_lawnmower"),
            field.robot,
            out=here,
            start_from=start,
            seed=seed,
            epochs=setting.profile.compact_epochs,
        )
        _grass_rows(scores, method, field, trained)
        tuned = trained_compact(
            field.west("dirt_lawnmower"),
            field.robot,
            out=setting.model(f"{method}_dirt", seed),
            start_from=here,
            seed=seed,
            epochs=setting.profile.compact_epochs,
        )
        _dirt_rows(scores, method, field, tuned)
    return scores


def resnet(strategy: str, setting: Setting, seed: int) -> Scores:
    """Train the paper's network in one of its three strategies; the one that the paper finds best goes on to dirt."""
    field, scores, profile = Field(setting, seed), Scores(), setting.profile
    method = f"resnet_{strategy}"
    here = setting.model(method, seed)
    trained = networks.trained_resnet(
        field.west("a_lawnmower"),
        field.robot,
        out=here,
        strategy=strategy,
        size=profile.resnet_size,
        epochs=profile.resnet_epochs[STRATEGIES.index(strategy)],
        seed=seed,
        start=setting.weights or setting.model("backbone", 0) / networks.BACKBONE_FILE,
    )
    _grass_rows(scores, method, field, trained)
    if strategy == "finetuned":
        tuned = networks.trained_resnet(
            field.west("dirt_lawnmower"),
            field.robot,
            out=setting.model(f"{method}_dirt", seed),
            strategy=strategy,
            size=profile.resnet_size,
            epochs=profile.dirt_epochs,
            seed=seed,
            start=here,
        )
        _dirt_rows(scores, method, field, tuned)
    return scores


def map_floor(setting: Setting, seed: int) -> Scores:
    """Estimate what the heightmap contains at all: the compact network with many times the data.

    The data are of the same robot on other sites of the test set's own kind, surveyed in the same way.
    """
    field, scores, profile = Field(setting, seed, heightmap_from="survey"), Scores(), setting.profile
    paper = len(field.drive("a_lawnmower").segments) // _PAPER_SHARE
    for site, rows in (("grass_a", ("V-A", "V-B")), ("grass_b", ("V-C",)), ("dirt", ("V-E rest", "V-E other"))):
        out = setting.model(f"map_floor_{site}", seed)
        examples = more_examples(site, seed, profile, segments=profile.more * paper)
        trained = networks.compact_on_more(examples, out=out, seed=seed, epochs=profile.more_epochs)
        for row in rows:
            scores.add("map_floor", row, networks.predicted_j(trained, field.test(row), field.robot), field.test(row))
    return scores


def learning_curve(setting: Setting, seed: int) -> Scores:
    """Judge networks on random drives over sites A and B after some metres of training on site A.

    The test sets are called "METRES V-B" and "METRES V-C".
    """
    field, scores = Field(setting, seed), Scores()
    for method, start in (("curve_shipped", networks.SHIPPED), ("curve_scratch", None)):
        for metres in setting.profile.curve_m:
            model: Predictor
            if metres == 0:
                model = load_predictor("default") if start is not None else PhysicsPredictor()
            else:
                model = trained_compact(
                    _driven(field, setting.profile, metres),
                    field.robot,
                    out=setting.model(f"{method}_{metres}", seed),
                    start_from=start,
                    seed=seed,
                    epochs=setting.profile.compact_epochs,
                )
            for row in ("V-B", "V-C"):
                test = field.test(row)
                scores.add(method, f"{metres} {row}", networks.predicted_j(model, test, field.robot), test)
    return scores


def other_heightmap(setting: Setting, seed: int) -> Scores:
    """Repeat V-A on the kind of heightmap that the other experiments do not use."""
    kind = setting.other_heightmap
    field, scores = Field(setting, seed, heightmap_from=kind), Scores()
    west, test = field.west("a_lawnmower"), field.test("V-A")
    for method, fit in _BASELINES:
        scores.add(f"{method}_{kind}", "V-A", fit(west, field.robot)(test), test)
    trained = trained_compact(
        west,
        field.robot,
        out=setting.model(f"compact_{kind}", seed),
        start_from=networks.SHIPPED,
        seed=seed,
        epochs=setting.profile.compact_epochs,
    )
    scores.add(f"compact_{kind}", "V-A", networks.predicted_j(trained, test, field.robot), test)
    return scores


def field_of(setting: Setting, seed: int) -> dict[str, Any]:
    """Simulate the drives of a seed."""
    return make_field(setting.field(seed), seed, setting.profile)


EXPERIMENTS: Mapping[str, Callable[[Setting, int], Scores]] = {
    "baselines": baselines,
    "compact": compact,
    "resnet_frozen": lambda setting, seed: resnet("frozen", setting, seed),
    "resnet_scratch": lambda setting, seed: resnet("scratch", setting, seed),
    "resnet_finetuned": lambda setting, seed: resnet("finetuned", setting, seed),
    "map_floor": map_floor,
    "learning_curve": learning_curve,
    "other_heightmap": other_heightmap,
}


def _grass_rows(scores: Scores, method: str, field: Field, trained: Predictor) -> None:
    for row in ("V-A", "V-B", "V-C", "V-E"):
        scores.add(method, row, networks.predicted_j(trained, field.test(row), field.robot), field.test(row))
    scores.add_shifted(method, scores.arrays[f"{method}/V-E"], field.test("V-E"))


def _dirt_rows(scores: Scores, method: str, field: Field, tuned: Predictor) -> None:
    for row in ("V-E rest", "V-E other"):
        scores.add(method, row, networks.predicted_j(tuned, field.test(row), field.robot), field.test(row))


def _driven(field: Field, profile: Profile, metres: int) -> Measured:
    """About so many metres on site A, always at least two runs."""
    if metres <= len(field.drive("a_short").files) * profile.short_m:
        return field.drive("a_short").of_runs(0, max(2, round(metres / profile.short_m)))
    lanes = field.drive("a_lawnmower")
    each = len(lanes.segments) / len(lanes.files)
    count = min(max(2, round(metres / each)), len(lanes.files))
    spread = np.linspace(0, len(lanes.files) - 1, count).round().astype(int).tolist()
    parts = [lanes.of_runs(k, k + 1) for k in spread]
    return replace(
        lanes,
        files=tuple(part.files[0] for part in parts),
        segments=concatenate_segments([part.segments for part in parts]),
        explained_j=np.concatenate([part.explained_j for part in parts]),
    )
