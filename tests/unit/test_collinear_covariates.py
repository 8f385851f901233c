"""Causes are distinguished from collinear covariates, which correct the form of a cause and stay in the model."""

from dataclasses import replace

import numpy as np

from joulemap.model.loop.report import report_document
from joulemap.service.loop.summary import collinear_words
from tests.reference.drives import ROBOT, found_in, made_up, noisy, smooth_noise

BEFORE = {"name": "made up", "version": "1"}


def reported(found):
    """(names of the causes, names of the covariates, document) of the report."""
    document = report_document(found, before=BEFORE, after="2")
    assert [e.term.name for e in found.effects if e.shadow] == [s["name"] for s in document["collinear"]]
    return [e["name"] for e in document["effects"]], [s["name"] for s in document["collinear"]], document


def leaning(rng):
    """A drive whose wheels roll more than the map says, with the roll logged; and the squared tangent they feel."""
    drive = made_up(rng)
    felt = drive.cross + 0.012 * smooth_noise(rng, len(drive))
    squared = drive.cross**2
    drive = replace(
        drive, cross_abs=np.abs(drive.cross), cross_sq=squared, columns=drive.columns | {"roll": np.degrees(felt)}
    )
    return drive, felt**2


def test_a_measured_tilt_is_the_shadow_of_the_slope_across():
    rng = np.random.default_rng(3)
    drive, squared = leaning(rng)
    found = found_in(drive, noisy(rng, drive, 25.0 * ROBOT.weight_n * squared))
    causes, covariates, document = reported(found)
    assert causes == ["cross_slope"]
    assert covariates == ["learned:roll"]
    assert collinear_words(document).startswith("Roll (fitted curve) is in the calibrated model too: collinear")
    (row,) = [c for c in document["candidates"] if c["name"] == "learned:roll"]
    assert not row["taken"]
    assert "not an effect of its own" in row["why_not"]
    (gain,) = [c for c in document["candidates"] if c["name"] == "sensor_gain"]
    assert gain["p_value"] < 0.05  # alone; the slope across says it all
    assert gain["why_not"] == "beside the effects found, not significant"
    alone = [e.term for e in found.effects if not e.shadow]
    both = [e.term for e in found.effects]
    extra = 25.0 * ROBOT.weight_n * squared
    off = [np.mean((extra - sum(t.energy(drive) for t in some)) ** 2) for some in (alone, both)]
    assert off[1] < 0.7 * off[0]  # it stays in the model for what it is good for


def test_a_measured_tilt_alone_is_no_shadow():
    rng = np.random.default_rng(4)
    drive, squared = leaning(rng)
    level = np.zeros(len(drive))
    drive = replace(drive, cross=level, cross_abs=level, cross_sq=level)  # a map that knows nothing of it
    causes, covariates, document = reported(found_in(drive, noisy(rng, drive, 25.0 * ROBOT.weight_n * squared)))
    assert "learned:roll" in causes
    assert covariates == []
    assert collinear_words(document) == ""


def test_a_true_second_effect_is_a_cause_whatever_its_form():
    """Turning, and a loss that grows with the roughness along a curve that no formula has."""
    rng = np.random.default_rng(5)
    drive = made_up(rng)
    bumps = 20.0 * np.tanh((drive.roughness_m / 0.01 - 1.0) / 0.3)
    causes, covariates, _ = reported(found_in(drive, noisy(rng, drive, 60.0 * drive.turned_abs_rad + bumps)))
    assert set(causes) == {"turning", "learned:roughness"}
    assert covariates == []
