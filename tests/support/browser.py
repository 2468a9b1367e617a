"""A browser without a window, and pages of it; the browser is Debian's."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Page, sync_playwright

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
TIMEOUT = 30.0  # [s] for anything that a page is to show


@contextmanager
def browser(folder: Path, **options: Any) -> Iterator[BrowserContext]:
    """A browser whose data go to a folder."""
    program = shutil.which("chromium")
    if program is None:
        pytest.fail("the tests of the page need a browser: apt-get install chromium")
    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            folder, executable_path=program, headless=True, args=[*FLAGS], **options
        )
        context.set_default_timeout(TIMEOUT * 1000.0)
        yield context
        context.close()


def watched(page: Page) -> list[str]:
    """Collect what a page does wrong: errors of its scripts, and requests to anywhere else."""
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(f"error: {error}"))

    def requested(request: Any) -> None:
        if not request.url.startswith(("http://127.0.0.1:", "data:", "blob:")):
            wrong.append(f"outside: {request.url}")

    page.on("request", requested)
    return wrong


def read(page: Page, selector: str) -> str:
    """The text of an element."""
    return page.locator(selector).first.inner_text()


def until(page: Page, condition: Any, what: str, timeout: float = TIMEOUT) -> None:
    """Poll until a condition holds, while the page goes on."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"waited {timeout:g} s in vain for {what}")
        page.wait_for_timeout(50)
