"""Running a page as its reader does: every block in the order printed, in one folder that was empty.

What a page says of its blocks:

* ```sh: typed as it stands.
* ```console: what follows `$ ` is typed; the lines below are what it prints. `…` stands for lines or
  the end of a line left out, and a number may differ in its last printed digit. Without lines below, nothing is compared.
* ```pycon and ```python: typed into one Python that lives as long as the page.
* `<!-- file: NAME -->` above a block: it is the content of that file. `<!-- not run: REASON -->`: it is not run.
* A command that serves (`residuum serve`) goes on until the page ends, and is then interrupted as by Ctrl-C.

Packages of an extra are not there before the page says `residuum[EXTRA]`.
"""

import contextlib
import doctest
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from residuum.identification.physics.effects import EFFECTS

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(
    r"^(?:<!-- (?P<note>[^>]*?) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
TYPED = ("sh", "console", "pycon", "python")
SHOWN = ("yaml", "json", "toml", "text", "nginx", "caddy")
INDENTED = re.compile(r"\n\n    \S[^\n]*")
SERVES = re.compile(r"(\w+=\S+ )*residuum (serve|machine) ")
EXTRAS = {
    "notebook": ("pandas", "xarray", "control"),
    "fmi": ("fmpy",),
    "opcua": ("asyncua",),
    "formats": ("asammdf", "h5py"),
}
NUMBER = re.compile(r"-?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")
PATIENCE = 300.0


class Block(NamedTuple):
    """A fenced block of a page: its language, its text, the remark above it, and the page before it."""

    language: str
    text: str
    note: str
    before: str

    @property
    def excused(self):
        return self.note.startswith("not run: ")


def blocks(page):
    """The fenced blocks of a page, in the order printed."""
    page = page.read_text(encoding="utf-8")
    return [
        Block(
            match["language"],
            match["text"],
            " ".join((match["note"] or "").split()),
            page[: match.start()],
        )
        for match in BLOCK.finditer(page)
    ]


def typed_lines(text):
    """What is typed in a `console` block, each with the lines that it shall print."""
    typed = []
    for line in text.splitlines():
        if line.startswith("$ "):
            typed.append((line[2:], []))
        else:
            typed[-1][1].append(line)
    return typed


def unit_in_the_last_place(number):
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def alike(shown, printed):
    """Whether two texts say the same, blanks and the last printed digit of each number aside; `…` at the end leaves words out."""
    if shown.endswith(" …"):
        shown = shown.removesuffix(" …")
        printed = " ".join(printed.split()[: len(shown.split())])
    if NUMBER.sub("#", shown).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(abs(float(a) - float(b)) <= 1.001 * unit_in_the_last_place(a) for a, b in pairs)


def as_shown(shown, printed):
    """Whether the printed lines are those of the page, where `…` stands for any."""
    if not shown:
        return not printed
    if shown[0].strip() == "…":
        return any(as_shown(shown[1:], printed[left_out:]) for left_out in range(len(printed) + 1))
    return bool(printed) and alike(shown[0], printed[0]) and as_shown(shown[1:], printed[1:])


class _Checker(doctest.OutputChecker):
    def check_output(self, want, got, optionflags):
        return super().check_output(want, got, optionflags) or alike(want, got)


class Reader:
    """Somebody who types what a page says, in the present folder; `failures` are the lines that did not do what it shows."""

    def __init__(self, page, start, environment):
        self.page, self.start = page, start
        self.environment = environment | {"PYTHONPATH": f"{start}:{ROOT}"}
        self.failures, self.names, self.services = [], {"__name__": "page"}, []

    def read(self):
        for line in INDENTED.findall(BLOCK.sub("", self.page.read_text(encoding="utf-8"))):
            self._fail(0, line.strip(), "is in no fenced block, and so neither run nor excused")
        for number, block in enumerate(blocks(self.page), start=1):
            if block.note.startswith("file: "):
                Path(block.note.removeprefix("file: ")).write_text(block.text, encoding="utf-8")
            elif block.language in TYPED and not block.excused:
                with self._installed(block.before):
                    getattr(self, f"type_{block.language}")(block.text, number)
            elif block.language not in (*TYPED, *SHOWN):
                self._fail(
                    number, block.text, f"language {block.language!r} is neither run nor shown"
                )

    def type_sh(self, text, number):
        self._shell(text, number)

    def type_console(self, text, number):
        for typed, shown in typed_lines(text):
            if SERVES.match(f"{typed} "):
                self._serve(typed, number)
                continue
            printed = self._shell(typed, number)
            if shown and not as_shown(shown, printed):
                self._fail(number, typed, "\n".join(["shown:", *shown, "printed:", *printed]))

    def type_pycon(self, text, number):
        test = doctest.DocTestParser().get_doctest(
            text, self.names, f"{self.page.name}, block {number}", str(self.page), 0
        )
        runner = doctest.DocTestRunner(
            _Checker(), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        )
        runner.run(test, out=self.failures.append, clear_globs=False)
        self.names |= test.globs

    def type_python(self, text, number):
        exec(compile(text, f"{self.page.name}, block {number}", "exec"), self.names)

    def leave(self):
        """End what serves, as Ctrl-C does."""
        for typed, service in self.services:
            os.killpg(service.pid, signal.SIGINT)
            if self._ended(service) not in (0, 130, -signal.SIGINT):
                self._fail(0, typed, f"ended with status {service.returncode}")

    @contextlib.contextmanager
    def _installed(self, said):
        """Only those extras that the page has named by now: the packages of others are missing, in commands and here."""
        absent = [
            name
            for extra, names in EXTRAS.items()
            if f"residuum[{extra}]" not in said
            for name in names
        ]
        start = f"import sys\nsys.modules.update(dict.fromkeys({absent}))\n"
        (self.start / "sitecustomize.py").write_text(start, encoding="utf-8")
        with pytest.MonkeyPatch.context() as patch:
            for name in absent:
                patch.setitem(sys.modules, name, None)
            yield

    def _shell(self, typed, number):
        ended = subprocess.run(
            ["bash", "-ec", typed],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
        )
        # the answer is no: README, exit statuses
        answered = ended.returncode == 1 and typed.startswith("residuum ")
        if (ended.returncode and not answered) or "Warning: " in ended.stderr:
            self._fail(number, typed, f"status {ended.returncode}: {ended.stdout}{ended.stderr}")
        return ended.stdout.rstrip().splitlines()

    def _serve(self, typed, number):
        output = Path(f".service-{len(self.services)}")
        with output.open("w") as said, output.with_suffix(".log").open("w") as log:
            service = subprocess.Popen(
                ["bash", "-ec", f"exec env {typed}"],
                env=self.environment,
                stdout=said,
                stderr=log,
                start_new_session=True,
            )
        self.services.append((typed, service))
        end = time.monotonic() + PATIENCE
        while not output.read_text().strip() and service.poll() is None and time.monotonic() < end:
            time.sleep(0.1)
        if service.poll() is not None:
            self._fail(number, typed, f"does not serve: {output.with_suffix('.log').read_text()}")

    def _ended(self, service):
        try:
            return service.wait(PATIENCE)
        finally:
            if service.poll() is None:
                os.killpg(service.pid, signal.SIGKILL)

    def _fail(self, number, typed, what):
        self.failures.append(f"{self.page.name}, block {number}: {typed}\n{what}")


@pytest.fixture
def run_page(tmp_path, tmp_path_factory, monkeypatch):
    """Type a page, in a folder of its own; gives what failed. Added effects go again, and services end."""
    monkeypatch.chdir(tmp_path)

    def run(page):
        port = _free_port()
        search = {"PATH": f"{sys.prefix}/bin:{os.environ['PATH']}"}
        address = {"RESIDUUM_PORT": str(port), "RESIDUUM_URL": f"http://127.0.0.1:{port}"}
        reader = Reader(page, tmp_path_factory.mktemp("start"), os.environ | search | address)
        try:
            reader.read()
        finally:
            reader.leave()
        return reader.failures

    yield run
    EFFECTS._added.clear()
    EFFECTS._fingerprints.clear()


def _free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
