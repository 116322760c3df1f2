"""Headless Chromium for tests, where it is installed."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest


def chromium(profile: Path) -> Iterator[Any]:
    """A browser without habits of its own; skips the test, with a reason, if there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("needs chromium and chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for option in ("--headless", "--no-sandbox", "--no-first-run"):
        options.add_argument(option)
    for option in ("background-networking", "component-update", "gpu", "quic", "sync"):
        options.add_argument(f"--disable-{option}")
    options.add_argument(f"--user-data-dir={profile}")
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield browser
    browser.quit()


def until(browser: Any, script: str | Callable[[], Any]) -> Any:
    """What a script, or a function, returns once that is true."""
    from selenium.webdriver.support.ui import WebDriverWait

    found = script if callable(script) else lambda: browser.execute_script(script)
    return WebDriverWait(browser, 20, 0.05).until(lambda _: found())
