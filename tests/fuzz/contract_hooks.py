"""What Schemathesis' requests are given before they are sent: ids of what exists, and places that are on the map."""

from __future__ import annotations

import json
import os
from typing import Any

import schemathesis
from schemathesis.core.parameters import ParameterLocation

KNOWN = "JOULEMAP_KNOWN"
"""Variable of the environment with ids, start, goal and the planners that use all of their time, as JSON."""


@schemathesis.hook
def before_call(context: Any, case: Any, kwargs: dict[str, Any]) -> None:
    """Only what was generated as valid is replaced, by what is as valid."""
    known = json.loads(os.environ[KNOWN])
    if _is_valid(case, ParameterLocation.PATH):
        parameters = case.path_parameters or {}
        parameters.update({name: value for name, value in known.items() if name in parameters})
    if _is_valid(case, ParameterLocation.QUERY) and case.query:
        _towards_the_map(case.query, known)
    if _is_valid(case, ParameterLocation.BODY) and isinstance(case.body, dict):
        _body(case.body, known)
    if isinstance(case.body, dict):
        _hurry(case.body, known)


def _hurry(body: dict[str, Any], known: dict[str, Any]) -> None:
    """A planner that uses all of its time limit has little."""
    limit = body.get("time_limit_s", 5.0)
    if isinstance(limit, float | int) and limit > 0.1 and body.get("planner") in known["planners"]:
        body["time_limit_s"] = 0.1


def _is_valid(case: Any, location: ParameterLocation) -> bool:
    found = case.meta.components.get(location) if case.meta is not None else None
    return found is None or found.mode.is_positive


def _towards_the_map(query: dict[str, Any], known: dict[str, Any]) -> None:
    for x, y, place in (("x", "y", "start"), ("start_x", "start_y", "start"), ("goal_x", "goal_y", "goal")):
        if x in query and y in query:
            query[x], query[y] = known[place]


def _body(body: dict[str, Any], known: dict[str, Any]) -> None:
    for name in ("runs", "base_runs", "test_runs"):
        if body.get(name):
            body[name] = [known["runs_id"]]
    if "heightmap_id" in body:
        body["heightmap_id"] = known["heightmap_id"]
    if isinstance(body.get("model"), str):
        body["model"] = "physics"
    for name, place in (("start", "start"), ("goal", "goal"), ("position", "start"), ("home", "goal")):
        if body.get(name) is not None:
            body[name] = known[place]
    for name in ("path", "stops"):
        if isinstance(body.get(name), list):
            body[name] = [known["start"], known["goal"]]
