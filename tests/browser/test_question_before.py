"""The answer to a question before is never shown as that of the question now: it is dim and says so at once."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from tests.browser.chromium import PHONE, inaccessible, opened
from tests.browser.looks import LOOK, SLOW, Service, check

WALK_S = float(os.environ.get("JOULEMAP_WALK_S", "3"))
"""Seconds of the random walk; the time for the questions that are asked again to compare comes on top."""
ROUTE = ("verdict", "ways", "along", "labels", "curve", "files")
LOOKED_AT = {"route": ROUTE, "reach": ("reach",), "homeward": ("homeward",)}


@pytest.fixture(scope="module")
def maps(address: str) -> list[str]:
    """Two cost maps of the sample, with different robots; of cells of 2 m, which are asked four times as fast."""
    with httpx.Client(base_url=address, timeout=400.0) as client:
        while client.get("/readyz").status_code != 200:
            time.sleep(0.2)
        ground = client.get("/page/sample.tif").content
        kept = client.post("/v1/heightmaps", content=ground, params={"name": "sample"}).json()["id"]
        found = []
        for robot in ({}, {"mass_kg": 70.0, "battery_wh": 400.0}):
            wish = {"heightmap_id": kept, "model": "physics", "robot": robot, "spacing_m": 2.0}
            made = client.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}).json()
            assert made["status"] == "done", made
            found.append(made["id"])
        return found


@pytest.fixture
def tab(request: pytest.FixtureRequest, browser: Any, address: str, maps: list[str]) -> Iterator[Any]:
    """A route with everything that the page shows of it; its answers can be held back."""
    hash = f"#map={maps[0]}&from=22,96&to=178,104&battery=0.03,0&others=1"
    with opened(browser, address, hash=hash, **getattr(request, "param", {})) as tab:
        tab.page.evaluate(SLOW, [1, 0, 0])
        tab.page.click("#tab-route")
        tab.page.evaluate("document.querySelectorAll('#step-route details').forEach(one => { one.open = true; })")
        tab.page.wait_for_selector("#answer:not(.stale)[aria-busy=false] .verdict")  # what it shows moves the box
        tab.page.check("#turn-back")
        current(tab)
        yield tab


def current(tab: Any) -> None:
    """Wait until everything on the page is the answer to the question as it is now."""
    tab.page.wait_for_selector("#homeward:not(.stale)[aria-busy=false] p")
    tab.page.wait_for_selector("#reach-said:not(.stale)[aria-busy=false] p")
    tab.page.wait_for_selector("#answer:not(.stale)[aria-busy=false] .verdict")


Step = Callable[[Any], None]


def fill(selector: str, value: str) -> Step:
    return lambda tab: tab.page.fill(selector, value)


def entered(selector: str, value: str) -> Step:
    def act(tab: Any) -> None:
        tab.page.fill(selector, value)
        tab.page.press(selector, "Enter")

    return act


def lift(tab: Any) -> None:
    """A marker that is held in the air."""
    box = tab.page.locator(".pin.goal").bounding_box()
    tab.page.mouse.move(box["x"] + 14, box["y"] + 14)
    tab.page.mouse.down()
    tab.page.mouse.move(*tab.place(150.0, 60.0), steps=4)


def put_back(tab: Any) -> None:
    tab.page.mouse.up()
    undo(tab)


def undo(tab: Any) -> None:
    tab.page.click("#undo")


def by_key(tab: Any) -> None:
    tab.page.focus(".pin.start")
    tab.page.keyboard.press("ArrowUp")


def stop(tab: Any) -> None:
    tab.page.click("text=Add stop")
    tab.page.mouse.click(*tab.place(60.0, 150.0))


def corners(tab: Any) -> None:
    tab.page.click("text=Draw an area")
    for place in ((60.0, 40.0), (80.0, 40.0), (80.0, 70.0)):
        tab.page.mouse.click(*tab.place(*place))


def press(key: str) -> Step:
    def act(tab: Any) -> None:
        tab.page.focus("#map")
        tab.page.keyboard.press(key)

    return act


def area(tab: Any) -> None:
    corners(tab)
    press("Enter")(tab)


def other_map(tab: Any) -> None:
    tab.page.select_option("#maps", index=1 - tab.page.evaluate("document.getElementById('maps').selectedIndex"))


def other_robot(tab: Any) -> None:
    tab.page.click("#tab-map")
    tab.page.click("#again")
    tab.page.fill("#robot input >> nth=0", "50")


def same_robot(tab: Any) -> None:
    tab.page.click("#keep")
    tab.page.click("#tab-route")


def box(selector: str, value: str, before: str) -> tuple[Step, Step]:
    return fill(selector, value), fill(selector, before)


def choice(selector: str, value: str, before: str) -> tuple[Step, Step]:
    return lambda tab: tab.page.select_option(selector, value), lambda tab: tab.page.select_option(selector, before)


EVERYTHING, NOT_REACH = "route reach homeward", "route homeward"
INPUTS: dict[str, tuple[tuple[Step, Step], str]] = {
    "round trip": (
        (lambda tab: tab.page.check("#round-trip"), lambda tab: tab.page.uncheck("#round-trip")),
        EVERYTHING,
    ),
    "charge, by slider": (box("#charge input[type=range]", "50", "3"), EVERYTHING),
    "charge, typed": (box("#charge input[type=number]", "50", "3"), EVERYTHING),
    "charge, not there": (box("#charge input[type=number]", "", "3"), EVERYTHING),
    "reserve": (box("#reserve input[type=number]", "2", "0"), EVERYTHING),
    "start, being typed": (box("#place-start", "30, 90", "22, 96"), EVERYTHING),
    "start, typed": ((entered("#place-start", "30, 90"), undo), EVERYTHING),
    "goal, typed": ((entered("#place-goal", "150, 60"), undo), NOT_REACH),
    "goal, in the air": ((lift, put_back), NOT_REACH),
    "goal, dragged": ((lambda tab: tab.drag(".pin.goal", 150.0, 60.0), undo), NOT_REACH),
    "start, by keyboard": ((by_key, undo), EVERYTHING),
    "both swapped": ((lambda tab: tab.page.click("#swap"), undo), EVERYTHING),
    "stop": ((stop, undo), NOT_REACH),
    "area, being drawn": ((corners, press("Escape")), EVERYTHING),
    "area": ((area, undo), EVERYTHING),
    "alternatives": (box("#others", "2", "1"), NOT_REACH),
    "objective": (choice("#objective", "arrival", "mean"), NOT_REACH),
    "power": (box("#power", "400", ""), NOT_REACH),
    "search": (choice("#planner", "dijkstra", "astar"), NOT_REACH),
    "cost map": ((other_map, other_map), EVERYTHING),
    "robot": ((other_robot, same_robot), EVERYTHING),
    "probability": (box("#confidence input[type=range]", "60", "95"), "reach"),
    "capacity": (box("#capacity", "100", "280"), EVERYTHING),
}


def test_dim_at_once(tab: Any) -> None:
    """Each input, while no answer comes; what was answered is bright again when the question is that one again."""
    before = tab.page.evaluate(LOOK)
    for name in (name for names in LOOKED_AT.values() for name in names):
        assert before[name], name
    assert not any(before["says"])
    tab.page.evaluate("hold()")
    for name, ((act, back), concerned) in INPUTS.items():
        act(tab)
        look = tab.page.evaluate(LOOK)
        for kind in concerned.split():
            assert not any(look[one] for one in LOOKED_AT[kind]), (name, kind, look)
        assert any(words.startswith("For the question before") for words in look["says"]), (name, look)
        if "route" not in concerned:
            assert [look[one] for one in ROUTE] == [before[one] for one in ROUTE], name
        if name != "capacity":  # that of the robot, or the same typed: these are two questions
            back(tab)
            tab.page.wait_for_function("() => !document.querySelector('[data-of].stale')")
            assert tab.page.evaluate(LOOK)["verdict"] == before["verdict"], name
    tab.page.evaluate("release()")


PHONE_DARK = pytest.param({"viewport": PHONE, "color_scheme": "dark"}, marks=pytest.mark.slow)


@pytest.mark.parametrize("tab", [{}, PHONE_DARK], indirect=True, ids=["wide", "phone"])
def test_yes_becomes_no(tab: Any) -> None:
    """The case that was found: there is a yes, and for there and back a no."""
    tab.page.fill("#charge input[type=number]", "1.2")
    current(tab)
    assert not tab.page.query_selector("#answer .verdict.no")
    tab.page.evaluate("hold()")
    tab.page.check("#round-trip")
    assert not tab.page.evaluate(LOOK)["verdict"]
    assert tab.page.get_attribute("#answer", "aria-busy") == "true"
    assert tab.page.inner_text("[role=status][data-of=answer]") == "For the question before; asking …"
    assert not [one for one in inaccessible(tab.page) if one[0] != "color-contrast"]  # what is dim is not in use
    tab.page.uncheck("#round-trip")  # the question that was answered: there is nothing to wait for
    assert tab.page.evaluate(LOOK)["verdict"]
    tab.page.check("#round-trip")
    tab.page.evaluate("release()")
    tab.page.wait_for_selector("#answer:not(.stale) .verdict.no")
    assert tab.page.get_attribute("#answer", "aria-busy") == "false"


def test_an_error_leaves_no_verdict(tab: Any) -> None:
    """Nor does it stay when the question is changed back before the answer of the second one is there."""
    tab.page.route("**/feasibility", lambda route: route.fulfill(status=503, body='{"detail": "too many"}'))
    tab.page.check("#round-trip")
    tab.page.wait_for_selector("#answer:not(.stale) .error")
    look = tab.page.evaluate(LOOK)
    assert not any(look[name] for name in ("verdict", "ways", "labels", "curve", "homeward"))
    tab.page.uncheck("#round-trip")
    assert not tab.page.evaluate(LOOK)["error"]
    current(tab)


def _walk(tab: Any, seed: int, seconds: float, service: Service) -> int:
    rng = np.random.default_rng(seed)
    place = lambda: rng.uniform(10.0, 190.0, 2)  # noqa: E731

    def drag(name: str) -> None:
        tab.drag(f".pin.{name}", *place())

    def slide(name: str) -> None:
        tab.page.fill(f"#{name} input[type=range]", str(rng.integers(1, 90)))

    def type_in(box: str, text: str) -> None:
        tab.page.fill(box, "")
        for letter in text:
            tab.page.press(box, letter if letter != " " else "Space")
            look()
        if rng.random() < 0.7:
            tab.page.press(box, "Enter")

    def draw() -> None:
        if tab.page.query_selector("#areas [aria-label]"):
            tab.page.click("#areas [aria-label]")
            return
        tab.page.click("text=Draw an area")
        x, y = place()
        for dx, dy in ((0, 0), (20, 0), (20, 20)):
            tab.page.mouse.click(*tab.place(min(190.0, x + dx), min(190.0, y + dy)))
        tab.page.focus("#map")
        tab.page.keyboard.press("Enter")

    def visit() -> None:
        if tab.page.is_visible("#no-stops"):
            tab.page.click("#no-stops")
        else:
            tab.page.click("text=Add stop")
            tab.page.mouse.click(*tab.place(*place()))

    acts: list[Callable[[], object]] = [
        lambda: drag("goal"),
        lambda: drag("start"),
        lambda: tab.page.set_checked("#round-trip", rng.random() < 0.5),
        lambda: slide("charge"),
        lambda: slide("reserve"),
        lambda: slide("confidence"),
        lambda: type_in("#place-goal", ", ".join(f"{value:.0f}" for value in place())),
        lambda: type_in("#charge input[type=number]", str(rng.integers(1, 100))),
        lambda: tab.page.fill("#others", str(rng.integers(0, 3))),
        lambda: tab.page.select_option("#objective", str(rng.choice(["mean", "quantile", "arrival"]))),
        lambda: tab.page.select_option("#planner", str(rng.choice(["astar", "dijkstra"]))),
        lambda: other_map(tab),
        lambda: tab.page.click("#swap"),
        lambda: tab.page.evaluate("document.getElementById('undo').click()"),
        draw,
        visit,
    ]
    kept: list[dict[str, Any]] = []

    def look() -> None:
        found = tab.page.evaluate(LOOK)
        if found["says"][0]:
            assert not any(found[name] for name in (*ROUTE, "error")), found
        kept.append(found)

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        acts[rng.integers(len(acts))]()
        look()
        for _ in range(rng.integers(0, 4)):
            tab.page.wait_for_timeout(int(rng.integers(0, 250)))
            look()
    return sum(check(one, service) for one in {json.dumps(one): one for one in kept}.values())


@pytest.mark.parametrize(
    ("seed", "seconds"), [(0, WALK_S), pytest.param(1, 60.0, marks=pytest.mark.slow)], ids=["short", "a minute"]
)
def test_at_random(browser: Any, address: str, maps: list[str], seed: int, seconds: float) -> None:
    """Drags, ticks and types, with answers that come late, in any order, or broken."""
    hash = f"#map={maps[0]}&from=22,96&to=178,104&battery=0.03,0&others=1"
    with opened(browser, address, hash=hash) as tab:
        tab.page.evaluate(SLOW, [seed + 1, 400, 0.05])
        tab.page.evaluate("document.querySelectorAll('#step-route details').forEach(one => { one.open = true; })")
        tab.page.check("#turn-back")
        assert _walk(tab, seed, seconds, Service(address)) > 2
        assert not re.search("undefined|NaN|null", tab.text("body"))
