"""Draws the pictures of the page in the documentation, from the sample: python -m tests.browser.pictures"""

from __future__ import annotations

import io
import tempfile
import time
from pathlib import Path

import httpx
from PIL import Image

from tests.browser.chromium import PHONE, launched, opened
from tests.browser.conftest import serving

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "pictures"


def main() -> None:
    """The page with its route, wide and light, and on a phone in the dark."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), workers=1) as url, launched() as browser:
        while httpx.get(f"{url}/readyz").status_code != 200:
            time.sleep(0.2)
        with opened(browser, url) as tab:
            tab.page.set_default_timeout(200_000)  # on a busy machine too
            tab.page.click("#sample")
            tab.drawn()
            tab.page.wait_for_function("() => location.hash.includes('to=')")
            link = tab.page.evaluate("location.hash").split("&at=")[0].replace("battery=1,0.2,6", "battery=1,0.2,9")
        for name, options in (("page", {}), ("page-phone", {"viewport": PHONE, "color_scheme": "dark"})):
            with opened(browser, url, hash=f"{link}&back=1", **options) as tab:
                tab.page.set_default_timeout(200_000)
                tab.page.wait_for_function("() => joulemap.now.answer?.back")
                tab.drawn()
                tab.page.wait_for_timeout(2500)
                picture = Image.open(io.BytesIO(tab.page.screenshot())).convert("RGB")
                picture.quantize(256, kmeans=3).save(FOLDER / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
