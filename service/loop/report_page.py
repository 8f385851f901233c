"""report.html: what a calibration found and what to do with it, in one file that loads nothing else."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from joulemap.model.energy.metrics import LEAST_J
from joulemap.model.loop.report import ALPHA
from joulemap.model.runs.words import count_words, number_words, quantity_name, quantity_words
from joulemap.service.loop.calibration import Calibrated
from joulemap.service.loop.effect_words import (
    base_name,
    coefficient_words,
    found_words,
    is_centred,
    is_log_fault,
    is_shown,
    labels_of,
)
from joulemap.service.loop.report_figures import (
    LEAST_SPAN,
    against_figures,
    change_figure,
    curve_figure,
    error_figure,
    prediction_figures,
    residual_maps,
)
from joulemap.service.loop.summary import (
    NextStep,
    drive_words,
    error_states,
    error_words,
    headline,
    level_words,
    likeliest,
    odds_words,
    plan_words,
    range_words,
    site_words,
    unit_of,
    unknown_words,
    validation_words,
    variation_words,
)
from joulemap.service.render.pictures import route_picture
from joulemap.service.words import p_words, percent

_TEMPLATE = Path(__file__).with_name("report.html")
_NUMBER = re.compile(r"(<= )?[-+]?[\d.,e]+( \S+){0,3}")
_ALIKE = 0.005  # of the mean energy per metre: less than this is no change of the map
_WORDS: tuple[Any, ...] = (
    *(base_name, coefficient_words, count_words, drive_words, error_states, error_words, found_words, is_log_fault),
    *(is_shown, labels_of, level_words, likeliest, number_words, odds_words, percent, plan_words, quantity_name),
    *(quantity_words, range_words, site_words, unknown_words, variation_words),
)
"""What the template says things with."""


def report_page(made: Calibrated, *, steps: Sequence[NextStep] = ()) -> str:
    """Return the page."""
    document = made.document
    judged = [(f"these runs: {validation_words(document)}", document["segments"]["fit"], document["error"])]
    if "test_set" in document:
        judged.insert(0, ("test runs", document["test_set"]["segments"], document["test_set"]["error"]))
    main = next((site["runs"] for site in document.get("sites", []) if site["main"]), None)
    loader = jinja2.FunctionLoader(lambda _: re.sub(r"\s*\n\s*", " ", _TEMPLATE.read_text(encoding="utf-8")))
    jinja = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    jinja.filters |= {"text": _text, "kind": _kind, "p_words": p_words, "number_words": number_words}
    jinja.filters["curve_figure"] = curve_figure
    jinja.tests["centred"] = is_centred
    jinja.globals |= {words.__name__: words for words in _WORDS}
    jinja.globals |= {"number": _number, "quantity": _quantity, "metres": _metres, "pi": math.pi}
    jinja.globals |= {"ALPHA": ALPHA, "LEAST_J": LEAST_J, "LEAST_SPAN": LEAST_SPAN, "ALIKE": _ALIKE}
    page = jinja.get_template(_TEMPLATE.name).render(
        made=made,
        document=document,
        steps=steps,
        title=headline(document),
        unit=unit_of(document),
        judged=judged,
        main_runs=main,
        error_figure=error_figure,
        change_figure=change_figure,
        prediction_figures=prediction_figures,
        residual_maps=residual_maps,
        against_figures=against_figures,
        picture=lambda: _picture(made),
    )
    return re.sub(r"(?<=\d) (?=%)", "&nbsp;", page.strip()) + "\n"


def _text(words: str) -> Markup:
    """Escaped; what is in backticks is code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", escape(words)))


def _kind(cell: str) -> Markup:
    return Markup(' class="number"' if _NUMBER.fullmatch(cell) else "")


def _quantity(value: float, unit: str) -> str:
    return f"{number_words(value)} {unit}".rstrip()


def _metres(metres: float, coverage: Mapping[str, Any]) -> str:
    share = f" ({percent(metres / coverage['track_m'])})" if coverage["track_m"] > 0 else ""
    return f"{metres:,.0f} m{share}"


def _number(value: float | None) -> str:
    return "" if value is None else p_words(value).removeprefix("= ")


def _picture(made: Calibrated) -> str:
    """Both routes on the terrain."""
    assert made.routes is not None
    shown, names = made.routes.shown, ("planned after", "planned before")
    picture = route_picture(made.heightmap, shown.after, shown.repriced, title="", names=names)
    return base64.b64encode(picture).decode("ascii")
