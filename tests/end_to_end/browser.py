"""Headless Chromium for tests: found or loudly missed; every violation and error on the console is kept."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import BrowserContext, Locator, Page, sync_playwright

ROOT = Path(__file__).resolve().parents[2]
ARTIFACTS = Path(os.environ.get("CS3D_PICTURES") or ROOT / "artifacts")
"""Where pictures go, which is no part of the tree unless somebody wants to renew one of the documentation."""
AXE = ROOT / ".cache" / "axe" / "node_modules" / "axe-core" / "axe.min.js"

ARGUMENTS = ("--no-sandbox", "--disable-background-networking", "--disable-dev-shm-usage", "--disable-gpu")

WIDE = {"width": 1440, "height": 900}
PHONE = {"width": 360, "height": 740}
AIR_PX = 24


def missing(what: str) -> None:
    """Skip the test on a laptop, fail it in CI: there nothing may be missing."""
    message = f"BROWSER TEST NOT RUN: {what}"
    if os.environ.get("CI"):
        pytest.fail(message)
    pytest.skip(message)


def chromium() -> str:
    """Find Chromium."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        missing("there is no Chromium; `apt-get install chromium`")
    return found or ""


def axe_source() -> str:
    """Give the source of axe-core, fetched once with npm into the cache folder."""
    if not AXE.is_file():
        npm = shutil.which("npm")
        if npm is None:
            missing("axe-core needs npm; `apt-get install npm`")
        folder = AXE.parents[2]
        folder.mkdir(parents=True, exist_ok=True)
        command = [npm or "", "install", "--no-save", "--no-package-lock", "--prefix", str(folder), "axe-core@4"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=180)
        if done.returncode:
            missing(f"npm could not fetch axe-core: {done.stderr[-300:]}")
    return AXE.read_text(encoding="utf-8")


@dataclass
class Visitor:
    """One browser window, with everything its console complained about."""

    context: BrowserContext
    page: Page
    url: str
    complaints: list[str] = field(default_factory=list)

    def open(self, path: str) -> None:
        """Go to a page of the site."""
        self.page.goto(self.url + path)

    def log_in(self, email: str, password: str) -> None:
        """Log in by the form."""
        self.open("/login")
        self.page.get_by_label("E-mail address").fill(email)
        self.page.get_by_label("Password").fill(password)
        self.page.get_by_role("button", name="Log in").click()
        self.page.get_by_role("button", name="Log out").wait_for()

    def screenshot(self, name: str, *, down_to: Locator | None = None) -> Path:
        """Keep a picture of the whole page, or of its upper part with an element and a little air below."""
        ARTIFACTS.mkdir(exist_ok=True)
        path = ARTIFACTS / f"{name}.png"
        box = down_to.bounding_box() if down_to else None
        upper: Any = (
            {"x": 0, "y": 0, "width": WIDE["width"], "height": box["y"] + box["height"] + AIR_PX} if box else None
        )
        self.page.screenshot(path=path, full_page=True, clip=upper)
        return path

    def width_px(self) -> int:
        """Measure how wide the page is; more than the window means sideways scrolling."""
        width: int = self.page.evaluate("document.documentElement.scrollWidth")
        return width

    def barriers(self) -> list[str]:
        """List what axe-core finds wrong with the page for people with disabilities (WCAG 2.2 A and AA)."""
        self.page.evaluate(axe_source())
        tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
        found: dict[str, Any] = self.page.evaluate(
            "tags => axe.run(document, {runOnly: {type: 'tag', values: tags}})", tags
        )
        return [
            f"{violation['id']}: {node['target']} {node['failureSummary'][:200]}"
            for violation in found["violations"]
            for node in violation["nodes"]
        ]


@contextmanager
def browsing(url: str, **options: Any) -> Iterator[Visitor]:
    """Open a window; at its end nothing may have been complained about."""
    options = {"viewport": WIDE, **options}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=list(ARGUMENTS))
        context = browser.new_context(**options)
        page = context.new_page()
        visitor = Visitor(context, page, url)
        page.on("console", lambda message: _hear(visitor, message.type, message.text))
        page.on("pageerror", lambda error: visitor.complaints.append(str(error)))
        try:
            yield visitor
        finally:
            context.close()
            browser.close()
    assert visitor.complaints == []


def _hear(visitor: Visitor, kind: str, text: str) -> None:
    if kind in ("error", "warning") or "Content Security Policy" in text:
        visitor.complaints.append(f"{kind}: {text}")
