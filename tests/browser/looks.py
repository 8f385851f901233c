"""What the page shows at one moment: the question by its controls, and every number of an answer that is not dim."""

from __future__ import annotations

import math
import re
from typing import Any

import httpx

SLOW = """([seed, most, broken]) => {
  const real = window.fetch;
  const random = () => { seed = (seed * 1103515245 + 12345) % 2147483648; return seed / 2147483648; };
  let held = null;
  window.hold = () => {
    held = new Promise(done => { window.release = () => { held = null; done(); }; });
  };
  window.fetch = async (...asked) => {
    if (!/costmaps\\/[^/]+\\/(paths|feasibility|tours|reach|return)/.test(asked[0])) return real(...asked);
    if (held) await held;
    const answer = await real(...asked);
    await new Promise(done => setTimeout(done, most * random()));
    return random() < broken ? new Response(JSON.stringify({ detail: "broken by the test" }), { status: 503 }) : answer;
  };
}"""
"""Answers come late, in any order, some of them broken; between hold() and release() none come."""

LOOK = """() => {
  const { now, map } = joulemap, here = id => document.getElementById(id);
  const bright = node => {
    let all = 1;
    for (; node; node = node.parentElement) all *= getComputedStyle(node).opacity;
    return all > 0.9;
  };
  const text = node => node.textContent.replaceAll("\\u202f", "").trim();
  const all = selector => [...document.querySelectorAll(selector)];
  const shown = selector => all(selector).filter(bright).map(text);
  const boxes = id => here(id).querySelector("input[type=number]").value, pins = {}, labels = [];
  map.eachLayer(layer => {
    if (layer instanceof L.Marker) pins[layer.options.alt] = [layer.getLatLng().lng, layer.getLatLng().lat];
    const label = layer.getTooltip?.()?.getContent();
    const line = layer instanceof L.Polyline && !(layer instanceof L.Polygon);
    if (line && label && bright(layer.getElement())) labels.push(text(label));
  });
  return {
    asked: {
      map: here("maps").value, start: here("place-start").value, goal: here("place-goal").value, pins,
      charge: boxes("charge"), reserve: boxes("reserve"), confidence: boxes("confidence"),
      capacity: here("capacity").value,
      back: here("round-trip").checked, others: here("others").value, objective: here("objective").value,
      quantile: here("quantile").value, power: here("power").value, planner: here("planner").value,
    },
    state: { start: now.start, goal: now.goal, stops: now.stops, avoid: now.avoid },
    verdict: shown("#answer .verdict :is(p, li)"), error: shown("#answer .error"),
    ways: all("#answer tbody tr").filter(bright).map(row => [...row.cells].map(text)),
    along: now.cursor === null ? shown("#along") : [], labels,
    curve: all("#profile svg[aria-valuemax]").filter(bright).map(svg => svg.getAttribute("aria-valuemax")),
    reach: shown("#reach-said p").filter(words => !words.startsWith("Searching")), homeward: shown("#homeward p"),
    files: all("#step-save button:enabled").map(text).filter(words => now.answer && !/GeoTIFF|Zarr|Copy/.test(words)),
    says: all(".asked").map(text), busy: here("answer").getAttribute("aria-busy"),
  };
}"""


def _decimals(most: float) -> int:
    return min(4, max(0, 2 - math.floor(math.log10(abs(most) or 1.0))))


def metres(value: float, most: float) -> str:
    """A length as the page writes it."""
    return f"{value / 1000:.1f} km" if most >= 10_000.0 else f"{value:.{min(1, _decimals(most))}f} m"


def energy(value_j: float, most_j: float) -> str:
    """An energy as the page writes it."""
    return f"{value_j / 3600:.{_decimals(most_j / 3600)}f} Wh"


class Service:
    """The service without the page; a question that was asked before is not asked again."""

    def __init__(self, address: str) -> None:
        self.client = httpx.Client(base_url=address, timeout=60.0)
        self._known: dict[str, httpx.Response] = {}

    def ask(self, path: str, body: dict[str, Any]) -> httpx.Response:
        """The answer to a question."""
        key = f"{path} {body}"
        if key not in self._known:
            self._known[key] = self.client.post(path, json=body)
        return self._known[key]

    def for_odds(self, path: str, body: dict[str, Any]) -> Any:
        """The same with a confidence, and without one where the model gives no odds."""
        found = self.ask(path, body)
        return (self.ask(path, {**body, "confidence": None}) if found.status_code == 422 else found).json()


def check(look: dict[str, Any], service: Service) -> int:
    """Whatever is not dim must be what the service answers to the question of the controls. 1 where anything was."""
    asked, state = look["asked"], look["state"]
    shown = ("verdict", "ways", "error", "along", "labels", "curve", "reach", "homeward", "files")
    if not any(look[name] for name in shown):
        return 0
    for name, label in (("start", "Start"), ("goal", "Goal")):
        if state[name]:
            for place in ([float(one) for one in asked[name].split(",")], asked["pins"][label]):
                assert len(place) == 2, (name, look)
                assert math.dist(place, state[name]) < 0.008, (name, look)
    here = f"/v1/costmaps/{asked['map']}"
    battery = {
        "charge": float(asked["charge"]) / 100,
        "reserve": float(asked["reserve"]) / 100,
        "capacity_wh": float(asked["capacity"]),
    }
    limits = {"max_power_w": float(asked["power"]) if asked["power"] else None}
    common = {"battery": battery, "avoid": state["avoid"]}
    aim = {"objective": asked["objective"], "quantile": float(asked["quantile"]) / 100, **limits}
    ends = {"start": state["start"], "goal": state["goal"]}
    if state["stops"]:
        places = [state["start"], *state["stops"], *([state["goal"]] if state["goal"] else [])]
        replies = [service.ask(f"{here}/tours", {"stops": places, **common})]
    else:
        more = {"planner": asked["planner"], "alternatives": int(asked["others"])}
        replies = [service.ask(f"{here}/paths", {**ends, **common, **aim, **more})]
        if asked["back"]:
            replies.append(service.ask(f"{here}/feasibility", {**ends, **common, **aim, "round_trip": True}))
    bad = [one for one in replies if one.status_code != 200]
    if look["error"]:
        assert bad or "broken by the test" in look["error"], look
        assert not look["verdict"] + look["labels"] + look["curve"], look
    elif any(look[name] for name in shown[:6]):
        assert not bad, (look, [one.text for one in bad])
        _check_route(look, [one.json() for one in replies], float(asked["capacity"]) * 3600)
    if look["reach"] and "broken by the test" not in look["reach"]:
        _check_reach(look, battery, service)
    if look["homeward"] and "broken by the test" not in look["homeward"] and not bad:
        path = [place[:2] for place in replies[0].json()["path"]]
        body = {"position": state["start"], "home": state["start"], "path": path, **common}
        place = service.for_odds(f"{here}/return", body)["point_of_no_return"]
        words = f"after {metres(place['distance_m'], place['distance_m'])} of" if place else ""
        assert words in look["homeward"][0], look
    return 1


def _check_route(look: dict[str, Any], answers: list[dict[str, Any]], full_j: float) -> None:
    found, verdict = answers[0], answers[-1] if len(answers) > 1 else answers[0]["battery"]
    ways = [found, found.get("shortest"), *found.get("alternatives", [])]
    ways[2:2] = [answers[1]["back"]] if len(answers) > 1 else []
    ways = [way for way in ways if way]
    most_j, longest = (max(way[name] for way in ways) for name in ("energy_j", "length_m"))
    rows = [[energy(way["energy_j"], most_j), metres(way["length_m"], longest)] for way in ways]
    seen = [[row[1], row[3]] for row in look["ways"] if not row[0].startswith("before")]
    assert seen in ([], rows), (look, rows)
    share = f"{100 * found['energy_j'] / full_j:.{_decimals(100 * most_j / full_j)}f} %"
    assert not look["ways"] or look["ways"][0][2] == share, (look, share)
    if look["verdict"]:
        words = re.sub(r"^\w+[:,] |\.$", "", verdict["verdict_text"]).split("; ")
        assert look["verdict"][: len(words)] == words, (look, words)
        assert f"charge {100 * verdict['charge_at_start']:.0f} % at the start" in look["verdict"][-1], look
        if verdict["charge_at_end"] > 0:
            assert f"{100 * verdict['charge_at_end']:.1f} % expected" in look["verdict"][-1], look
    length, joules = found["length_m"], found["energy_j"]
    for label in look["along"]:
        assert f"{metres(length, length)}, {energy(joules, joules)}" in label, look
    for label in look["labels"]:
        words = [
            f"{energy(way['energy_j'], way['energy_j'])}, {metres(way['length_m'], way['length_m'])}" for way in ways
        ]
        assert label.startswith("before") or label.split(": ")[1] in words, (look, words)
    for end in look["curve"]:
        assert abs(float(end) - length) <= 0.6, (look, length)


def _check_reach(look: dict[str, Any], battery: dict[str, Any], service: Service) -> None:
    asked, start = look["asked"], look["state"]["start"]
    charge, reserve = battery["charge"], battery["reserve"]
    levels = [round(reserve + (charge - reserve) * share, 3) for share in (0.25, 0.5, 0.75, 1.0)]
    body = {
        "start": start,
        "battery": battery,
        "charges": levels if charge > reserve else None,
        "confidence": float(asked["confidence"]) / 100,
        "round_trip": asked["back"],
        "avoid": look["state"]["avoid"],
    }
    found = service.for_odds(f"/v1/costmaps/{asked['map']}/reach?format=geojson&coordinates=map", body)
    areas = [one["properties"]["area_m2"] for one in found["features"] if one["properties"]["area_m2"] > 0]
    sizes = [f"{area:.0f} m²" for area in areas] + [f"{area / 1e4:.1f} hectares" for area in areas]
    assert look["reach"][0].startswith(
        "From the start and back to it" if asked["back"] else "From the start one way"
    ) == ("Nothing can" not in look["reach"][0]), look
    lines = [line for line in look["reach"] if line.startswith("charge")]
    assert all(line.rsplit(", ", 1)[1] in sizes for line in lines), (look, sizes)
    assert bool(lines) == bool(sizes), (look, sizes)
