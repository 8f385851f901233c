"""Write what a reproduction found: REPRODUCTION.md, results.json and the figures."""

from __future__ import annotations

import json
from typing import Any

from service.reproduction.experiments import Setting
from service.reproduction.figures import draw_all
from service.reproduction.report import report
from service.reproduction.runner import read_results, read_setting
from service.reproduction.summary import Summary

REPORT_FILE = "REPRODUCTION.md"
RESULTS_FILE = "results.json"


def publish(setting: Setting, *, command: str) -> dict[str, Any]:
    """Write the three from the results in the folder; what results.json holds."""
    summary = Summary(read_results(setting))
    kept = read_setting(setting.folder)
    figures = draw_all(setting, summary)
    document = {"command": command, "setting": kept, **summary.as_dict()}
    text = report(summary, kept, command=command, figures=figures)
    (setting.folder / REPORT_FILE).write_text(text, encoding="utf-8")
    (setting.folder / RESULTS_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return document
