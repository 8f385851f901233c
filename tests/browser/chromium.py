"""Starts Chromium, opens the page in it, and looks for what must never happen there."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from functools import cache
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
WIDE, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}


def chromium_path() -> str | None:
    """Where Chromium is, None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@contextlib.contextmanager
def launched() -> Iterator[Any]:
    """Chromium without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium_path(), args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


class Opened:
    """The page in a tab of its own, with what it asked for and what went wrong in it."""

    def __init__(self, browser: Any, address: str, *, hash: str = "", **options: Any) -> None:
        self.context = browser.new_context(viewport=options.pop("viewport", WIDE), **options)
        self.page = self.context.new_page()
        self.page.set_default_timeout(60_000)
        self.asked: list[str] = []
        self.wrong: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("console", self._said)
        self.response = self.page.goto(f"{address}/{hash}")
        self.page.wait_for_selector("html[data-ready], dialog[open]", state="attached")  # a dialog where it wants a key

    def _said(self, message: Any) -> None:
        if message.type == "error" and "Failed to load resource" not in message.text:  # which the page shows in words
            self.wrong.append(message.text)

    def text(self, selector: str) -> str:
        """What a person reads there."""
        found: str = self.page.inner_text(selector)
        return found

    def drawn(self) -> None:
        """Wait until the answer to the question as it is now is there."""
        self.page.wait_for_selector("#answer:not(.stale) .verdict")
        self.page.wait_for_selector("#profile svg")

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Where on the screen a place of the map is."""
        at = self.page.evaluate(
            "([x, y]) => { const p = joulemap.map.latLngToContainerPoint([y, x]);"
            " const box = joulemap.map.getContainer().getBoundingClientRect(); return [p.x + box.x, p.y + box.y]; }",
            [x, y],
        )
        return at[0], at[1]

    def drag(self, selector: str, x: float, y: float) -> None:
        """Take hold of something and let it go at a place of the map."""
        box = self.page.locator(selector).bounding_box()
        self.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        self.page.mouse.down()
        self.page.mouse.move(*self.place(x, y), steps=4)
        self.page.mouse.up()

    def close(self) -> None:
        """Close the tab; nothing may have gone wrong in it, and nothing may have left this machine."""
        self.context.close()
        assert not self.wrong, self.wrong
        assert all(url.startswith(("http://127.0.0.1:", "blob:", "data:")) for url in self.asked), self.asked


@cache
def _axe() -> Any:
    from axe_core_python.sync_playwright import Axe

    return Axe()


def inaccessible(page: Any) -> list[tuple[str, list[str]]]:
    """What axe-core finds serious or critical in a page or a frame: the rule, and where.

    The lines inside of figures are left out, not the figures: thousands of them take most of the time.
    """
    found = _axe().run(page, {"exclude": [["div.figures svg > *"], ["div.full svg > *"]]})["violations"]
    bad = [one for one in found if one["impact"] in ("serious", "critical")]
    return [(one["id"], [node["html"][:200] for node in one["nodes"]]) for one in bad]


@contextlib.contextmanager
def opened(browser: Any, address: str, **options: Any) -> Iterator[Opened]:
    """The page in a tab; checked and closed in the end."""
    tab = Opened(browser, address, **options)
    yield tab
    tab.close()
