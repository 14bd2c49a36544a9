"""The page in Debian's Chromium: bytes over the wire, first paint, zooming into 10⁶ samples, memory of twenty tabs, the work of
the plant's page of forty machines for each window that is judged.

The server is a process of its own with one machine and one window of 10⁶ samples, a one-sample spike in each hundred
thousand. Bytes are what the server sends for the plant's page with everything it loads but the chart library, packed as
browsers ask for it. Paint is the first contentful paint of a second visit. A zoom is timed from the order to the chart's
last drawing of the new samples; at every stage the chart must hold the largest sample of the stretch it shows.
"""

from __future__ import annotations

import json
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

import residuum.service.web
from benchmarks.free_port import free_port
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.settings import load_settings
from residuum.service.storage import DiskStore

N, RATE = 1_000_000, 100_000
SPIKES = range(50_000, N, 100_000)
TABS = 20
MACHINES, ROUNDS = 40, 5
MB = 1e6
CHART = "document.querySelector('[aria-label=Signal]')"


def spiked() -> Record:
    """10 s at 100 kHz: noise of 1, and one sample of 100 + k in the middle of each second."""
    signal = np.random.default_rng(0).normal(size=N)
    for k, at in enumerate(SPIKES):
        signal[at] = 100.0 + k
    return Record({"acceleration": signal}, {"acceleration": "m/s²"}, 1 / RATE)


def started(data: Path) -> tuple[subprocess.Popen[bytes], str]:
    """A service on a free port, with the window in its store."""
    settings = load_settings(data=data)
    store = DiskStore(data, settings.database_url)
    store.add_window(
        "press",
        spiked(),
        Finding("bearing", "healthy", None, {"rms": 1.0}, {"rms": 2.0}, {"rms": "m/s²"}, {}, None),
    )
    store.close()
    port = free_port()
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "serve",
        "--data",
        str(data),
    ]
    server = subprocess.Popen([*command, "--port", str(port)], stdout=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}"
    for _ in range(600):
        try:
            urllib.request.urlopen(f"{url}/health/ready", timeout=5).close()
            return server, url
        except (urllib.error.URLError, OSError):
            time.sleep(0.1)
    raise RuntimeError("the service did not start")


def sent(browser: Browser, url: str) -> tuple[int, int, int]:
    """Bytes of our own files as sent and as they are on disk, and bytes of the chart library as sent."""
    page = browser.new_page()
    sizes: dict[str, int] = {}
    page.on(
        "response",
        lambda answer: sizes.update({answer.url: int(answer.headers.get("content-length", 0))}),
    )
    page.goto(f"{url}/#/machines/press")
    page.locator("[aria-label=Signal] .main-svg").first.wait_for()
    page.goto(f"{url}/#/workbench")
    page.locator("#file").wait_for(state="attached")
    page.close()
    own = sum(size for address, size in sizes.items() if "/web/" in address or address == f"{url}/")
    library = sum(size for address, size in sizes.items() if "/vendor/" in address)
    folder = Path(residuum.service.web.__file__).parent
    plain = sum(
        file.stat().st_size
        for file in folder.rglob("*")
        if file.suffix in (".html", ".css", ".js", ".svg")
    )
    return own, plain, library


def first_paints(browser: Browser, url: str, visits: int = 7) -> list[float]:
    """First contentful paint [s] of later visits."""
    context = browser.new_context()
    found = []
    for visit in range(visits + 1):
        page = context.new_page()
        page.goto(url)
        page.locator(".machine").wait_for()
        at = page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime")
        found += [at / 1e3] if visit else []
        page.close()
    context.close()
    return found


def zooms(browser: Browser, url: str) -> tuple[list[float], int]:
    """Seconds of each zoom into the neighbourhood of a spike, and how many stretches lacked their largest sample."""
    page = browser.new_page()
    page.goto(f"{url}/#/machines/press")
    page.wait_for_function(f"() => Math.max(...({CHART}?.data?.[0]?.y ?? [])) > 100")
    page.wait_for_timeout(1500)
    times, lost = [], int(_largest(page) != 100.0 + len(SPIKES) - 1)
    for k, at in enumerate(SPIKES):
        for half in (0.4, 0.02, 0.001):
            begin, end = at / RATE - half, at / RATE + half
            times.append(page.evaluate(_ZOOM, [begin, end]))
            lost += _largest(page) != 100.0 + k
    page.close()
    return times, lost


_ZOOM = """async ([begin, end]) => {
  const chart = document.querySelector('[aria-label=Signal]');
  const started = performance.now();
  const inside = () => chart.data[0].x[0] >= begin - 0.001 && chart.data[0].x.at(-1) <= end + 0.001;
  const drawn = new Promise((resolve) => chart.on('plotly_afterplot', () => inside() && resolve()));
  Plotly.relayout(chart, { 'xaxis.range[0]': begin, 'xaxis.range[1]': end });
  await drawn;
  chart.removeAllListeners('plotly_afterplot');
  return (performance.now() - started) / 1000;
}"""


def _largest(page: Page) -> float:
    return float(page.evaluate(f"Math.max(...{CHART}.data[0].y)"))


def growth(browser: Browser, url: str, server: int) -> float:
    """Resident memory [MB] that the server gains by twenty tabs on a machine's page, after one was open and closed."""
    warm = browser.new_page()
    warm.goto(f"{url}/#/machines/press")
    warm.locator("[aria-label=Signal] .main-svg").first.wait_for()
    warm.close()
    before = _memory(server)
    pages = [browser.new_page() for _ in range(TABS)]
    for page in pages:
        page.goto(f"{url}/#/machines/press")
        page.locator(".panel").first.wait_for()
    time.sleep(5)
    after = _memory(server)
    for page in pages:
        page.close()
    return (after - before) / MB


def updates(browser: Browser, url: str) -> tuple[float, int]:
    """Seconds of the main thread that the plant's page of forty machines takes for one judged window, and how many of its
    tasks took 50 ms or more (of those a browser tells).
    """
    for number in range(MACHINES):
        _judged(url, number)
    page = browser.new_page()
    page.goto(url)
    page.wait_for_function(f"() => document.querySelectorAll('.machine').length > {MACHINES - 1}")
    page.wait_for_timeout(3000)
    page.evaluate(_LONG_TASKS)
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")
    before = _task_seconds(session)
    for number in range(MACHINES * ROUNDS):
        _judged(url, number % MACHINES)
    page.wait_for_timeout(3000)
    spent = _task_seconds(session) - before
    long = int(page.evaluate("longTasks.length"))
    page.close()
    return spent / (MACHINES * ROUNDS), long


_LONG_TASKS = """() => {
  window.longTasks = [];
  new PerformanceObserver((list) => longTasks.push(...list.getEntries())).observe({ entryTypes: ['longtask'] });
}"""


def _task_seconds(session: CDPSession) -> float:
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def _judged(url: str, number: int) -> None:
    """One window of a machine, stored and judged."""
    signal = np.random.default_rng(number).normal(size=4096)
    window = {
        "sample_time": 1e-4,
        "channels": {"acceleration": signal.tolist()},
        "units": {"acceleration": "m/s²"},
    }
    urllib.request.urlopen(
        urllib.request.Request(
            f"{url}/api/v1/assets/machine-{number:02d}/windows?diagnoser=bearing",
            json.dumps(window).encode(),
            {"content-type": "application/json"},
        ),
        timeout=60,
    ).close()


def _memory(server: int) -> int:
    """Resident bytes of the server and its own worker processes."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    family = {server}
    while more := {process for process, parent in parents.items() if parent in family} - family:
        family |= more
    pages = [
        int((Path("/proc") / str(process) / "statm").read_text().split()[1]) for process in family
    ]
    return sum(pages) * resource.getpagesize()


def main() -> None:
    """Print the table."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        server, url = started(Path(folder))
        try:
            browser = playwright.chromium.launch(
                executable_path=chromium, args=["--no-sandbox", "--disable-dev-shm-usage"]
            )
            own, plain, library = sent(browser, url)
            paints, (times, lost) = first_paints(browser, url), zooms(browser, url)
            grown = growth(browser, url, server.pid)
            update, long = updates(browser, url)
            browser.close()
        finally:
            server.terminate()
            server.wait()
    print("| the page in Chromium | measured | limit |")
    print("|---|---|---|")
    print(
        f"| own HTML, CSS and JS over the wire (on disk {plain / 1e3:.0f} kB) | {own / 1e3:.1f} kB | 150 kB |"
    )
    print(f"| chart library over the wire, once an hour at most | {library / 1e3:.0f} kB | – |")
    print(
        f"| first contentful paint, warm (median, worst of {len(paints)}) | {_pair(paints)} s | 1 s |"
    )
    print(f"| zoom in 10⁶ samples (median, worst of {len(times)}) | {_pair(times)} s | 0.5 s |")
    print(f"| stretches without their one-sample spike, of {len(times) + 1} | {lost} | 0 |")
    print(f"| server's memory for {TABS} more tabs | {grown:.1f} MB | 20 MB |")
    print(f"| page of {MACHINES} machines, work a judged window | {1e3 * update:.0f} ms | 100 ms |")
    print(f"| its tasks of 50 ms and more, of {MACHINES * ROUNDS} windows | {long} | – |")


def _pair(values: list[float]) -> str:
    return f"{statistics.median(values):.2f}, {max(values):.2f}"


if __name__ == "__main__":
    main()
