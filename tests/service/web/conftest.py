"""Pages in Debian's Chromium: every page that a test opens must keep quiet on the console and stay with its server."""

import contextlib
import shutil

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect, sync_playwright

from residuum.service.alarms.alarm_states import AlarmRule

PATIENCE = 60_000  # milliseconds; two busy cores take long to read the chart library
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


TOO_WIDE = """() => document.documentElement.scrollWidth <= innerWidth ? [] :
  [...document.querySelectorAll('main *')].filter((element) =>
  element.getBoundingClientRect().right > innerWidth + 1 && !element.closest('.scroll, svg'))
    .map((element) => element.outerHTML.slice(0, 200))"""
CUT = """() => [...document.querySelectorAll('body *')].filter((element) => {
  if (!element.checkVisibility() || element.closest('svg, .visually-hidden, .skip, .scroll, pre, textarea')) return false;
  if (![...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim())) return false;
  const text = document.createRange();
  text.selectNodeContents(element);
  const box = text.getBoundingClientRect();
  for (let at = element; at; at = at.parentElement) {
    const frame = at.getBoundingClientRect();
    const hides = at === document.documentElement || getComputedStyle(at).overflowX !== 'visible';
    if (hides && (box.right > frame.right + 1 || box.left < frame.left - 1)) return true;
  }
  return false;
}).map((element) => element.outerHTML.slice(0, 200))"""
# the chart library's own controls, which only show under a pointer, are not ours to name
AXE = {"exclude": [[".modebar"]]}


class NoMachines:
    """A pipeline with nothing in it."""

    def __init__(self, *_parts):
        pass

    async def start(self):
        pass

    async def stop(self):
        pass

    def status(self):
        return {"machines": {}, "sources": {}}

    def alarm_rule(self, _asset):
        return AlarmRule()


@pytest.fixture(scope="module")
def no_machines():
    """The pipeline of a service without machines."""
    return NoMachines


@pytest.fixture
def fits():
    """Nothing of a page reaches beyond its window."""

    def check(page):
        assert page.evaluate(TOO_WIDE) == []

    return check


@pytest.fixture
def uncut(fits):
    """A page fits its window, and nothing hides a part of a text."""

    def check(page):
        fits(page)
        assert page.evaluate(CUT) == []

    return check


@pytest.fixture
def legible(fits):
    """A page fits its window, and axe finds nothing that keeps someone out of it: contrast, names, order, roles."""

    def check(page):
        fits(page)
        found = Axe().run(page, AXE)
        assert found.response["violations"] == [], found.generate_report()

    return check


# not longer: while it lives, no other test in this process can run an event loop
@pytest.fixture(scope="module")
def chromium():
    if CHROMIUM is None:
        pytest.skip(
            "NO CHROMIUM HERE, so the pages were not tested; sh tests/system_packages.sh installs it"
        )
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-dev-shm-usage"]
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=flags, timeout=3 * PATIENCE
        )
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium):
    """Open an address in a browser of its own; `expected` are parts of console lines that the test provokes."""
    with contextlib.ExitStack() as stack:
        complaints, foreign = [], []

        def open_page(url, *, size=(1280, 800), scheme="light", expected=(), **context):
            width, height = size
            opened = chromium.new_context(
                viewport={"width": width, "height": height}, color_scheme=scheme, **context
            )
            stack.callback(opened.close)
            page = opened.new_page()
            page.set_default_timeout(PATIENCE)
            # a route under way must not outlive its test
            stack.callback(page.unroute_all, behavior="ignoreErrors")

            def complain(text):
                if not any(part in text for part in expected):
                    complaints.append(text)

            page.on(
                "console",
                lambda line: complain(line.text) if line.type in ("error", "warning") else None,
            )
            page.on("pageerror", lambda error: complain(str(error)))
            page.on("dialog", lambda dialog: complaints.append(f"dialog {dialog.message}"))
            origin = "/".join(url.split("/")[:3])
            page.on(
                "request",
                lambda sent: (
                    None
                    if sent.url.startswith((origin, "data:", "blob:"))
                    else foreign.append(sent.url)
                ),
            )
            page.goto(url)
            return page

        yield open_page
        assert complaints == []
        assert foreign == []
