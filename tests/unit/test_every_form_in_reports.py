"""Whatever a calibration may find, alone or in pairs, with baseline runs or without, ends in a report of every kind.

Which effects are chosen is given, the variation is fitted once, and what resists is settled in one round. All else is
the procedure itself: estimates, intervals, the report, words, the page, and the file of the model.
"""

import json
import re
from dataclasses import replace
from functools import cached_property
from html import escape
from itertools import combinations, pairwise

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.loop import _design, _procedure, _selection
from joulemap.model.loop._base_step import base_step
from joulemap.model.loop._selection import Selection, Verdict
from joulemap.model.loop.calibrate import calibrate
from joulemap.model.loop.calibration_file import read_calibrated, save_calibrated
from joulemap.model.loop.forms import CHANGES, FORMS, PlaceField
from joulemap.model.loop.forms._base_parameters import BaseParameters
from joulemap.model.loop.forms.simple_costs import SimpleCosts
from joulemap.model.runs.residuals import joined
from joulemap.service.loop import calibration
from joulemap.service.loop import report_page as page
from joulemap.service.loop.effect_words import curve_points
from joulemap.service.loop.measured import segments_document
from joulemap.service.loop.summary import summary_lines
from tests.reference.drives import ROBOT, made_up, measured_on, noisy
from tests.unit.test_report import documented, without_figures_of_runs

NO_NUMBER = re.compile(r"\b(nan|inf|none)\b", re.IGNORECASE)
ODD = "$_x^$ <b>"  # a formula to matplotlib, and an element to a browser


def logged(rng, *, runs):
    """Drives with every column that a form asks for, and one of an odd name."""
    rows = made_up(rng, runs=runs, each=80)
    blocks = np.arange(len(rows)) // 20
    columns = {
        "payload": 5.0 * (rows.run % 3) + blocks % 2,
        "wind_speed": 2.0 + rng.random(len(rows)),
        "arm_power_w": 20.0 * (blocks % 3),
        "wind_from": np.full(len(rows), 90.0),
        "heading": np.degrees(rows.heading_rad) + 180.0 * (blocks % 2),  # every other stretch backwards
        ODD: (blocks % 2).astype(float),
    }
    words = {"terrain": np.array(["", "grass", "mud", "sand"])[blocks % 4], ODD: np.array(["on", ODD])[blocks % 2]}
    return replace(rows, columns=rows.columns | columns, words=words)


class Runs:
    """Runs, and what is computed of them before effects are chosen."""

    def __init__(self, *, compared, runs=4, charge=False):
        rng = np.random.default_rng(5)
        rows, before = logged(rng, runs=runs), logged(rng, runs=runs)
        self.new = measured_on(rows, noisy(rng, rows, 20.0 * rows.turned_abs_rad), charge=charge)
        self.before = measured_on(before, noisy(rng, before), charge=charge) if compared else None
        both = joined([self.before, self.new]) if compared else self.new
        new = np.arange(len(both)) >= len(both) - len(self.new)
        self.base_step = base_step(both, new)
        self.design = _design.make_design(self.base_step[0], new, self.base_step[1])
        self.variation = _design.fit_model(self.design, []).variation
        self.known = {}

    @cached_property
    def forms(self):
        """Every variant that may be found."""
        return list(dict.fromkeys(c.form for c in self.design.candidates))

    @property
    def one_of_each(self):
        """A variant of every form and name; of curves one over the heading and one over a logged column."""
        some = [form for form in self.forms if form.key != "curve" or form.over in ("heading", f"column:{ODD}")]
        return list({(form.key, form.name): form for form in some}.values())

    def found(self, form, monkeypatch):
        """A calibration that chooses a form."""
        if form in self.known:
            return self.known[form]
        chosen = next(c for c in self.design.candidates if c.form == form)
        first = len(self.design.base.names)
        kept = np.append(np.arange(first), chosen.both)
        own = first + np.arange(len(chosen.both))
        candidate = replace(chosen, tested=own[: len(chosen.tested)], beside=own[len(chosen.tested) :])
        design = replace(
            self.design,
            columns=self.design.columns[:, kept],
            low=self.design.low[kept],
            high=self.design.high[kept],
            candidates=(candidate,),
        )

        def select(design, *_, **__):
            verdicts = tuple(Verdict(candidate, 1e-12, 0.2, False) for candidate in design.candidates)
            model = _design.fit_model(design, design.candidates, self.variation)
            return Selection(verdicts, design, verdicts, verdicts, model)

        with monkeypatch.context() as patch:
            patch.setattr(_procedure, "base_step", lambda *_: self.base_step)
            patch.setattr(_procedure, "make_design", lambda *_: design)
            patch.setattr(_procedure, "select", select)
            patch.setattr(_selection, "_ROUNDS", 1)
            patch.setattr(_design, "fit_variation", lambda variation, *_: variation)
            self.known[form] = calibrate(self.new, base=self.before, cross_validate=False)
        return self.known[form]

    def pair(self, forms, monkeypatch):
        """A calibration that found both, which these runs cannot distinguish."""
        one, two = (self.found(form, monkeypatch) for form in forms)
        a, b = (found.fitted.selection for found in (one, two))
        every = (*a.chosen, *b.chosen)
        every_verdict = {name: (*getattr(a, name), *getattr(b, name)) for name in ("taken", "alone", "last")}
        selection = replace(a, **every_verdict, design=replace(a.design, candidates=every))
        vars(selection)["rivals"] = {every[0].form.name: [every[1].form.name]}  # a cached property
        correction = one.fitted.correction
        terms, planned = (
            (*getattr(correction, name), *getattr(two.fitted.correction, name)[1:])
            for name in ("terms", "planner_terms")
        )
        fitted = replace(
            one.fitted,
            selection=selection,
            effects=(*one.effects, *two.effects),
            correction=replace(correction, terms=terms, planner_terms=planned),
        )
        return replace(one, fitted=fitted)


@pytest.fixture(scope="module", params=[False, True], ids=["alone", "with-baseline-runs"])
def runs(request):
    return Runs(compared=request.param)


DRAWN = {}


@pytest.fixture
def drawn_once(monkeypatch):
    """What depends on the runs and on no effect is left out, and of curves with as many points one is drawn."""
    draw = page.curve_figure

    def curve(effect):
        knots, values, intervals = curve_points(effect)
        over = effect["settings"]["over"]
        key = over in ("heading", f"column:{ODD}") and over, len(knots), len(values), len(intervals)
        DRAWN[key] = DRAWN.get(key) or draw(effect)
        return DRAWN[key]

    monkeypatch.setattr(page, "curve_figure", curve)
    without_figures_of_runs(monkeypatch)
    monkeypatch.setattr(page, "error_figure", lambda *_: "<svg></svg>")
    monkeypatch.setattr(calibration, "fit_spread", lambda *_, **__: None)


def check(found, folder):
    """Write and say everything that a calibration does; return the document and the page."""
    correction = calibration.correction_of(found, np.ones(len(found.residuals)))
    save_calibrated(folder, correction, {"name": "physics", "version": "1"})
    assert read_calibrated(folder)[0] == correction
    made = documented(found)
    made.document.update(calibration._turning(found, PhysicsPredictor(), ROBOT, correction))
    text = json.dumps([made.document, segments_document(found)], allow_nan=False)
    document, _ = json.loads(text)
    lines, html = summary_lines(document), page.report_page(made)
    assert [line for line in lines if NO_NUMBER.search(line)] == []
    assert lines[0].startswith(f"Found: {', '.join(effect.term.form.title for effect in found.effects)}")
    for effect in document["effects"]:
        assert any(line.lower().startswith(f"  {effect['label']}: ".lower()) for line in lines)
        assert escape(effect["label"]) in html
        if effect["form"] == "curve":
            knots, values, intervals = curve_points(effect)
            assert len(knots) == len(values) == len(intervals)
    assert "<b>" not in html
    return document, html


def test_no_form_is_forgotten(runs):
    never = {BaseParameters.key, SimpleCosts.key} | (
        set() if runs.before else {form.key for form in CHANGES} | {PlaceField.key}
    )
    assert {form.key for form in runs.forms} == set(FORMS) - never


@pytest.mark.slow
def test_every_variant_of_every_form_ends_in_a_report(runs, monkeypatch, drawn_once, tmp_path):
    for number, form in enumerate(runs.forms):
        document, html = check(runs.found(form, monkeypatch), tmp_path / str(number))
        assert [effect["name"] for effect in document["effects"]] == [form.name]
        assert html.count("<svg") == 4 + (form.key == "curve")
        centred = form.key == "curve" and form.centred
        assert ("zero at its middle point" in html) == centred
        assert ("Zero is what the baseline runs show" in html) == (form.key == "curve" and not centred)


@pytest.mark.slow
def test_every_pair_ends_in_a_report(runs, monkeypatch, drawn_once, tmp_path):
    for number, pair in enumerate(combinations(runs.one_of_each, 2)):
        if pair[0].name != pair[1].name:  # one takes the place of the other
            _, html = check(runs.pair(pair, monkeypatch), tmp_path / str(number))
            assert "Effects that these runs cannot distinguish" in html


@pytest.mark.parametrize("options", [{"compared": False, "runs": 1}, {"compared": True, "charge": True}], ids=str)
def test_every_form_and_every_two_beside_each_other_end_in_a_report(options, monkeypatch, drawn_once, tmp_path):
    runs = Runs(**options)
    for number, form in enumerate(runs.one_of_each):
        check(runs.found(form, monkeypatch), tmp_path / str(number))
    for pair in pairwise(runs.one_of_each):
        check(runs.pair(pair, monkeypatch), tmp_path / pair[0].name)


def test_figures_of_runs_take_any_name(runs, monkeypatch):
    """Nothing is left out here."""
    found = runs.found(next(form for form in runs.forms if form.key == "turning"), monkeypatch)
    found = replace(found, residuals=replace(found.residuals, runs=tuple(f"{ODD}{k}" for k in range(4))))
    html = page.report_page(documented(found))
    assert html.count("<svg") > 12
    assert f"logged: {escape(ODD)}" in html
    assert all(f"{escape(ODD)}{k}</text>" in html for k in range(4))
