"""What tests that go through the network need: a running service, a database server, a message broker, on real sockets."""

import contextlib
import getpass
import os
import pwd
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
import uuid
from pathlib import Path

import pytest
import structlog
import uvicorn
from sqlalchemy import create_engine, text
from sqlalchemy.engine import make_url

from residuum.service.app import create_app
from residuum.service.settings import load_settings
from residuum.service.simulated.demo import train

PATIENCE = 60.0
# gw0, gw1, … when several processes run the tests, each its share
_PROCESS = os.environ.get("PYTEST_XDIST_WORKER")
_PORTS = range(20_000, 32_000, 1_500)  # below those of outgoing connections


def find_program(name):
    """A program of Debian's packages, wherever they put it; None when it is not installed."""
    folders = [
        *map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)),
        os.environ["PATH"],
        "/usr/sbin",
    ]
    return shutil.which(name, path=os.pathsep.join(folders))


def not_here(what, untested):
    """Skip loudly; fail where CI may install it, because CI must run these tests."""
    message = (
        f"NO {what} HERE, so {untested} was not tested; sh tests/system_packages.sh installs it"
    )
    if os.environ.get("CI") and os.getuid() == 0:
        pytest.fail(message)
    pytest.skip(message)


_chance = random.SystemRandom()


def _free_port():
    """A port that nobody listens at, and that no outgoing connection is given by the system before somebody does.

    (Who tries again and again to connect to a port of those, is in the end connected to himself and holds the port.) Each process
    that runs tests has ports of its own: it may be a while until somebody listens at one.
    """
    first = _PORTS[int((_PROCESS or "gw0").removeprefix("gw")) % len(_PORTS)]
    while True:
        port = first + _chance.randrange(_PORTS.step)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


@pytest.fixture(scope="session")
def demo_baseline(made_once):
    """Gives the baseline file of a machine of the demo, as the demo trains it."""

    def baseline(machine):
        return made_once(f"{machine}.zip", lambda file: train(machine, str(file.parent)))

    return baseline


@pytest.fixture
def log_lines():
    """What is logged during the test, of any severity, whatever a service in this process was told to leave out."""
    before = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(0))
    with structlog.testing.capture_logs() as lines:
        yield lines
    structlog.configure(**before)


@pytest.fixture
def free_port():
    """Gives ports that are free now."""
    return _free_port


@pytest.fixture
def free_channel():
    """Gives multicast CAN buses of their own, on this machine alone."""

    def channel():
        group = ".".join(str(_chance.randint(1, 250)) for _ in range(3))
        return f"udp_multicast:239.{group}:{_chance.randint(20_000, 32_000)}/0"

    return channel


def wait_for_port(port, process):
    end = time.monotonic() + PATIENCE
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5):
            return
        assert process.poll() is None and time.monotonic() < end, f"{process.args[0]} did not start"
        time.sleep(0.05)


@pytest.fixture(scope="session")
def postgresql():
    """The URL of a PostgreSQL server: RESIDUUM_TEST_POSTGRES, or one of our own for as long as the tests run."""
    if address := os.environ.get("RESIDUUM_TEST_POSTGRES"):
        yield address
        return
    initdb, postgres = find_program("initdb"), find_program("postgres")
    if initdb is None or postgres is None:
        not_here("POSTGRESQL", "the store on it")
    user = next(
        name
        for name in ("postgres", "nobody")
        if name in {entry.pw_name for entry in pwd.getpwall()}
    )
    user = user if os.getuid() == 0 else getpass.getuser()  # PostgreSQL refuses to be run by root
    other = (
        {"user": user, "group": pwd.getpwnam(user).pw_gid, "extra_groups": []}
        if os.getuid() == 0
        else {}
    )
    with tempfile.TemporaryDirectory(
        prefix="residuum-postgresql-", dir="/tmp", ignore_cleanup_errors=True
    ) as folder:
        shutil.chown(folder, user)
        make = [
            initdb,
            "-D",
            f"{folder}/data",
            "-A",
            "trust",
            "-U",
            "postgres",
            "-E",
            "UTF8",
            "--no-locale",
            "--no-sync",
        ]
        subprocess.run(make, check=True, capture_output=True, cwd=folder, **other)
        port = _free_port()
        start = [
            postgres,
            "-D",
            f"{folder}/data",
            "-p",
            str(port),
            "-k",
            folder,
            "-c",
            "listen_addresses=127.0.0.1",
        ]
        with subprocess.Popen(start, stderr=subprocess.DEVNULL, cwd=folder, **other) as server:
            try:
                wait_for_port(port, server)
                yield f"postgresql+psycopg://postgres@127.0.0.1:{port}/postgres?connect_timeout=10"
            finally:
                server.send_signal(signal.SIGINT)  # a fast, orderly end
                server.wait(PATIENCE)


@pytest.fixture(scope="session")
def new_postgresql_database(postgresql):
    """Makes empty databases, which are dropped in the end; gives their URLs."""
    server = create_engine(postgresql, isolation_level="AUTOCOMMIT")
    made = []

    def make():
        made.append(f"residuum_test_{uuid.uuid4().hex[:12]}")
        with server.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {made[-1]}"))
        return make_url(postgresql).set(database=made[-1]).render_as_string(hide_password=False)

    end = time.monotonic() + PATIENCE
    while True:
        try:
            server.connect().close()
            break
        except Exception:
            assert time.monotonic() < end, "PostgreSQL does not answer"
            time.sleep(0.1)  # it listens before it lets anybody in
    yield make
    with server.connect() as connection:
        for name in made:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    server.dispose()


@pytest.fixture
def start_mosquitto(tmp_path):
    """Starts a Mosquitto of our own at a port, with more lines of settings; gives the process, which is ended in the end."""
    mosquitto = find_program("mosquitto")
    if mosquitto is None:
        not_here("MOSQUITTO", "MQTT")
    with contextlib.ExitStack() as stack:

        def start(port, *lines):
            settings = tmp_path / f"mosquitto-{port}.conf"
            lines = (
                f"listener {port} 127.0.0.1",
                "allow_anonymous true",
                f"user {getpass.getuser()}",
                *lines,
            )
            settings.write_text("\n".join(lines))
            broker = stack.enter_context(
                subprocess.Popen([mosquitto, "-c", settings], stderr=subprocess.DEVNULL)
            )
            stack.callback(broker.terminate)
            wait_for_port(port, broker)
            return broker

        yield start


@pytest.fixture(scope="module")
def make_disk(tmp_path_factory):
    """Makes file systems of their own, of so many bytes; gives the folder, and `remount(folder, how)` to change them."""
    made = []

    def remount(folder, how):
        subprocess.run(["mount", "-o", f"remount,{how}", folder], check=True)

    def make(size):
        folder = tmp_path_factory.mktemp("disk")
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder]
        if (
            shutil.which("mount") is None
            or subprocess.run(mount, capture_output=True, check=False).returncode
        ):
            not_here("RIGHT TO MOUNT A FILE SYSTEM", "a disk that is full or read-only")
        made.append(folder)
        return folder, remount

    yield make
    for folder in made:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.fixture
def make_failing_disk(tmp_path):
    """Makes an ext4 file system of its own; gives its folder, `fail()`, after which it is read-only, and `repair()`."""
    image, folder = tmp_path / "disk.image", tmp_path / "failing"
    mount = ["mount", "-o", "loop,errors=remount-ro", image, folder]

    def make():
        folder.mkdir()
        with image.open("wb") as file:
            file.truncate(24 * 2**20)
        mkfs = find_program("mkfs.ext4")
        steps = [[mkfs or "false", "-q", image], mount]
        if any(subprocess.run(step, capture_output=True, check=False).returncode for step in steps):
            not_here("RIGHT TO MOUNT A FILE SYSTEM", "a disk that fails")
        return folder, fail, repair

    def fail():
        subprocess.run(["mount", "-o", "remount,abort", folder], check=True, capture_output=True)

    def repair():
        subprocess.run(["umount", folder], check=True)
        subprocess.run(mount, check=True)

    yield make
    subprocess.run(["umount", "--lazy", folder], capture_output=True, check=False)


class RunningService:
    """The service in a thread; `stop` and `start` again keep the port and the data."""

    def __init__(self, data, make_pipeline=None, **settings):
        self.port = _free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._settings = load_settings(
            data=data, port=self.port, workers=1, log_level="error", **settings
        )
        self._make_pipeline = make_pipeline
        self.start()

    def start(self):
        self.app = create_app(self._settings, self._make_pipeline)
        config = uvicorn.Config(
            self.app,
            port=self.port,
            log_config=None,
            access_log=False,
            proxy_headers=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, daemon=True)
        self._thread.start()
        end = time.monotonic() + 120
        while not self._server.started:
            assert self._thread.is_alive() and time.monotonic() < end, "the service did not start"
            time.sleep(0.02)

    @property
    def services(self):
        return self.app.state.services

    def stop(self):
        self._server.should_exit = True
        self._thread.join(120)
        assert not self._thread.is_alive(), "the service did not stop"


@pytest.fixture(scope="module")
def run_service(tmp_path_factory):
    with contextlib.ExitStack() as stack:

        def run(make_pipeline=None, data=None, **settings):
            service = RunningService(
                data or tmp_path_factory.mktemp("service"), make_pipeline, **settings
            )
            stack.callback(service.stop)
            return service

        yield run
