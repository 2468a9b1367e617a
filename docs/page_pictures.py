"""Make the pictures of docs/page.md: real runs, photographed in Debian's Chromium.

`python docs/page_pictures.py [FOLDER]` takes about three minutes.
"""

from __future__ import annotations

import io
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
SCREEN, PHONE = (1920, 1080), (412, 915)
COLOURS = 128  # of a picture
TIMEOUT = 240.0  # [s] for a run to come to the moment of a picture
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")


@dataclass(frozen=True)
class Picture:
    """A picture of a run.

    Attributes:
        name: Name of the file.
        at: Number of evaluations at which it is taken.
        size: Width and height of the window [pixels].
        query: End of the address.
        tab: Title of the tab of the details.
        dialog: Whether the question before a move is shown.
        whole: Whether the whole length of the page is shown.
        part: Selector of the part of the page that is shown alone; empty for all of it.
        compared: Runs that are compared in the history before.
    """

    name: str
    at: int
    size: tuple[int, int] = SCREEN
    query: str = ""
    tab: str = "All coordinates"
    dialog: bool = False
    whole: bool = False
    part: str = ""
    compared: Sequence[str] = ()


SCENES: Sequence[tuple[str, Sequence[str], Sequence[Picture]]] = (
    (
        "awa.yaml",
        ("--speed", "15", "--seed", "4", "--evaluations", "60"),
        (
            Picture("page", 36),
            Picture("page_move", 38, dialog=True),
            Picture("page_models", 39, tab="Models", part=".details"),
            Picture("page_diagnostics", 40, tab="Diagnostics", whole=True),
            Picture("page_phone", 42, PHONE),
        ),
    ),
    (
        "toy.yaml",
        ("--speed", "10", "--seed", "1", "--evaluations", "60"),
        (
            Picture("page_light", 18, query="?theme=light"),
            Picture("page_phone_light", 22, PHONE, "?theme=light"),
        ),
    ),
    (
        "toy.yaml",
        ("--speed", "10", "--seed", "2", "--evaluations", "300"),
        (Picture("page_history", 30, tab="History", part=".details", compared=("toy-1", "toy-2")),),
    ),
)
SHIPPED = ("page", "page_models", "page_phone", "page_light", "page_history")


@contextmanager
def run(config: str, options: Sequence[str], folder: str) -> Iterator[str]:
    """Run `mobo.py` and give the address of its page."""
    command = [
        sys.executable,
        str(ROOT / "mobo.py"),
        "run",
        "--config",
        str(ROOT / "config" / config),
    ]
    run_id = f"{config.partition('.')[0]}-{options[options.index('--seed') + 1]}"
    command += [*options, "--runs-dir", folder, "--run-id", run_id]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert process.stdout is not None
        for line in process.stdout:
            found = re.match(r"page: (\S+)", line)
            if found:
                yield found[1]
                return
        raise RuntimeError("the run has no page")
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()


def take(page: Page, address: str, picture: Picture, folder: Path) -> None:
    """Take a picture at its moment."""
    page.set_viewport_size({"width": picture.size[0], "height": picture.size[1]})
    page.goto(address + picture.query)
    page.wait_for_selector(".state-word")
    deadline = time.monotonic() + TIMEOUT
    while int((re.match(r"\d+", page.locator(".count").inner_text()) or ["0"])[0]) < picture.at:
        if time.monotonic() > deadline:
            raise TimeoutError(f"evaluation {picture.at} did not come")
        page.wait_for_timeout(100)
    page.locator(".point-table tbody tr").nth(3).locator("td").nth(2).click()
    page.get_by_role("tab", name=picture.tab).click()
    for run_id in picture.compared:
        page.get_by_role("checkbox", name=f"run {run_id}", exact=True).click()
    if picture.compared:
        page.get_by_role("button", name="Compare").click()
    if picture.tab == "Models" or picture.compared:
        page.wait_for_selector(".slice canvas", timeout=TIMEOUT * 1000.0)
    if picture.dialog:
        page.get_by_role("button", name="Go to point…").click()
    page.get_by_text("Chosen is").wait_for()
    page.wait_for_timeout(3000)  # for the plots
    page.evaluate("window.scrollTo(0, 0)")
    part = page.locator(picture.part or "body")
    content = part.screenshot() if picture.part else page.screenshot(full_page=picture.whole)
    image = Image.open(io.BytesIO(content))
    image.quantize(COLOURS).save(folder / f"{picture.name}.png", optimize=True)


def main() -> None:
    """Make all pictures, or only the shipped ones if no folder is given."""
    folder = Path(sys.argv[1]) if sys.argv[1:] else ROOT / "docs" / "images"
    folder.mkdir(exist_ok=True)
    program = shutil.which("chromium")
    if program is None:
        sys.exit("the pictures need a browser: apt-get install chromium")
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            f"{scratch}/browser", executable_path=program, headless=True, args=[*FLAGS]
        )
        for config, options, pictures in SCENES:
            with run(config, options, scratch) as address:
                page = context.new_page()  # the last one waits for its own run
                for picture in pictures:
                    if sys.argv[1:] or picture.name in SHIPPED:
                        take(page, address, picture, folder)
                page.close()
        context.close()


if __name__ == "__main__":
    main()
