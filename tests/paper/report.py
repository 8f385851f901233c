"""Tables of a reproduction, and its results as JSON. What they mean is in REPRODUCTION.md of this folder, by hand."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from tests.paper.profiles import STRATEGIES
from tests.paper.runner import read_results, read_setting
from tests.paper.setting import Setting
from tests.paper.summary import METHODS, PAPER, PAPER_PHYSICS, Summary, checks

TABLES_FILE = "TABLES.md"
RESULTS_FILE = "results.json"
_TESTS = {
    "V-A": "rest of site A, same pattern",
    "V-B": "site A, random waypoints",
    "V-C": "site B, random waypoints",
    "V-D": "rest of site A; friction of 5 m for the next 5 m",
    "V-E": "dirt, as trained on grass",
    "V-E shifted": "the same, mean shifted",
    "V-E rest": "rest of the dirt site, fine-tuned on its west third",
    "V-E other": "another dirt run, fine-tuned likewise",
}
_ERROR, _ROUTE = "mean_relative_error", "route_relative_error"


def publish(setting: Setting, *, command: str) -> dict[str, Any]:
    """Write TABLES.md and results.json from the results in a folder."""
    summary = Summary(read_results(setting))
    kept = read_setting(setting.folder)
    document = {"command": command, "setting": kept, **summary.as_dict()}
    seconds = sum(float(found["seconds"]) for found in summary.facts.values())
    machine = f"{os.cpu_count()} cores of {platform.processor() or platform.machine()}"
    strategies = [f"resnet_{name}" for name in STRATEGIES] + ["compact_scratch", "compact"]
    others = [f"{method}_{setting.other_heightmap}" for method in ("physics", "gp", "ridge", "compact")]
    curve = ("curve_shipped", "curve_scratch")
    text = "\n".join(
        [
            f"`{command}`\n\n{datetime.now(UTC):%Y-%m-%d}, {machine}; {seconds / 60:.0f} minutes of one core. "
            f"Heightmap: {kept['heightmap_from']}. Backbone: {kept['backbone']}.\n",
            "## Mean relative error per 1 m segment, percent\n",
            _table(summary, [summary.name_of(column) for column in METHODS], list(_TESTS), _ERROR),
            "## Expected results\n",
            _lines(
                ["expected", "found", "holds"],
                [[check.wanted, check.found, "yes" if check.holds else "**no**"] for check in checks(summary)],
            ),
            "## Training strategies\n",
            _table(summary, strategies, list(_TESTS), _ERROR),
            "## Energy of whole routes, percent\n",
            _table(summary, [summary.name_of(column) for column in METHODS], list(_TESTS), _ROUTE),
            "## After metres of training\n",
            _table(summary, curve, summary.rows(curve[0]), _ERROR),
            f"## On a heightmap that is {setting.other_heightmap}\n",
            _table(summary, others, ["V-A"], _ERROR),
        ]
    )
    (setting.folder / TABLES_FILE).write_text(text, encoding="utf-8")
    (setting.folder / RESULTS_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return document


def _table(summary: Summary, methods: Sequence[str], rows: Sequence[str], number: str) -> str:
    """A row for each test set, a column for the paper and for each method."""
    body = []
    for row in rows:
        paper = f"{100 * PAPER[row]:.1f}" if row in PAPER and number == _ERROR else ""
        if row in PAPER_PHYSICS and number == _ERROR:
            paper = f"{paper} ({100 * PAPER_PHYSICS[row]:.1f})".strip()
        found = [summary.interval(method, row, number) for method in methods]
        body.append([row, _TESTS.get(row, ""), paper, *(one.words() if one is not None else "" for one in found)])
    return _lines(["section", "tested on", "paper", *methods], body)


def _lines(header: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    rows = [header, ["---"] * len(header), *body]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
