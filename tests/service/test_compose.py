"""docker-compose.yml: valid by the schema, hardened, and every command of ours starts as a process on real sockets."""

import getpass
import json
import random
import re
import subprocess
import sys
import time
import tomllib
import urllib.parse
import urllib.request
from pathlib import Path

import pytest
import yaml

from residuum.service.broker import broker_address
from residuum.service.commands import COMMANDS
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.notifications import Broker
from residuum.service.security.access import ApiKeys, Role
from residuum.service.settings import Settings, load_settings
from tests.service.conftest import find_program, not_here, wait_for_port

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
OURS = {
    name: service for name, service in COMPOSE["services"].items() if service["image"] == "residuum"
}
LASTING = {name: service for name, service in OURS.items() if name != "keys"}
KEYS = "/var/lib/residuum-keys"
"""Where the volume with the keys is, in every container that has it."""


def test_it_is_valid_by_the_compose_schema():
    import jsonschema  # takes seconds to load, which every process that collects tests would spend

    jsonschema.validate(
        COMPOSE, json.loads(Path(__file__).with_name("compose_schema.json").read_text())
    )


@pytest.mark.parametrize("name", OURS)
def test_our_containers_have_no_more_rights_than_they_need(name):
    service = OURS[name]
    assert service["read_only"] and service["cap_drop"] == ["ALL"] and service["user"] != "root"
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert {"cpus", "memory"} <= set(service["deploy"]["resources"]["limits"])


def test_what_is_referred_to_is_there():
    for service in COMPOSE["services"].values():
        assert set(service.get("networks", [])) <= set(COMPOSE["networks"])
        assert set(service.get("depends_on", {})) <= set(COMPOSE["services"])
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            assert (
                (ROOT / source).exists()
                if source.startswith("./")
                else source in COMPOSE["volumes"]
            )


def test_the_services_settings_name_the_machines_of_the_compose_file():
    machines = Settings(**yaml.safe_load((ROOT / "deploy" / "settings.yaml").read_text())).machines
    commands = {name: " ".join(service["command"]) for name, service in OURS.items()}
    for machine in machines:
        for source in machine.sources:
            address = source.channel if source.kind == "can" else f":{source.port}"
            assert address in commands[machine.asset]
            assert source.kind == "can" or source.host == machine.asset
            (read_dbc if source.kind == "can" else read_register_map)(source.map_file)


DOCKERFILE = (ROOT / "Dockerfile").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
IMAGES = {
    "postgres": {
        "port": 5432,
        "needs": {"POSTGRES_USER", "POSTGRES_PASSWORD", "POSTGRES_DB"},
        "keeps": "/var/lib/postgresql/data",
    },
    "eclipse-mosquitto": {
        "port": 1883,
        "needs": set(),
        "keeps": "/mosquitto/config/mosquitto.conf",
    },
    "prom/prometheus": {"port": 9090, "needs": set(), "keeps": "/prometheus"},
    "grafana/grafana": {"port": 3000, "needs": set(), "keeps": "/var/lib/grafana"},
}
"""What the images of others have, by their documentation: the port they listen on, variables that they need, where they keep."""


@pytest.mark.parametrize("name", OURS)
def test_our_commands_and_variables_are_those_of_the_image(name):
    program, command, *_ = OURS[name]["command"]
    assert program in PROJECT["scripts"] and command in COMMANDS
    variables = {
        variable.removeprefix("RESIDUUM_").lower() for variable in OURS[name].get("environment", {})
    }
    assert variables <= {*Settings.model_fields, "settings"}
    assert OURS[name]["user"].split(":")[0] in re.findall(r"useradd --uid (\d+)", DOCKERFILE)


def test_the_image_has_what_its_variables_ask_for():
    (extras,) = re.findall(r'pip install .*"\.\[(.*?)\]"', DOCKERFILE)
    environment = OURS["residuum"]["environment"]
    assert "psycopg" in environment["RESIDUUM_DATABASE"] and "postgres" in extras.split(",")
    assert environment["RESIDUUM_MQTT"].startswith("mqtt:") and "mqtt" in extras.split(",")
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    copied = {
        file
        for line in re.findall(r"^COPY (?!--from)(.*)$", DOCKERFILE, re.MULTILINE)
        for file in line.split()[:-1]
    }
    assert (
        all((ROOT / file).exists() for file in copied)
        and {PROJECT["readme"], *PROJECT["license-files"]} <= copied
    )


def test_ports_are_those_that_somebody_listens_on():
    published = {
        name: port
        for name, service in COMPOSE["services"].items()
        for port in service.get("ports", [])
    }
    assert {port.split(":")[0] for port in published.values()} == {"127.0.0.1"}, (
        "nothing is open to other machines"
    )
    for name, port in published.items():
        inside = port.split(":")[-1]
        other = IMAGES.get(COMPOSE["services"][name]["image"].split(":")[0])
        listens = (
            {str(other["port"])}
            if other
            else {*OURS[name]["command"], *re.findall(r"EXPOSE (\d+)", DOCKERFILE)}
        )
        assert inside in listens, f"{name} listens on {listens}, not on {inside}"


def test_services_name_each_other_by_host_port_and_password():
    environment = OURS["residuum"]["environment"]
    for url, image in (
        (environment["RESIDUUM_DATABASE"], "postgres"),
        (environment["RESIDUUM_MQTT"], "eclipse-mosquitto"),
    ):
        parts = urllib.parse.urlsplit(url)
        service = COMPOSE["services"][parts.hostname]
        assert service["image"].split(":")[0] == image and parts.port == IMAGES[image]["port"]
        assert set(service["networks"]) & set(OURS["residuum"]["networks"])
    database, given = (
        urllib.parse.urlsplit(environment["RESIDUUM_DATABASE"]),
        COMPOSE["services"]["postgres"]["environment"],
    )
    assert (database.username, database.password, database.path[1:]) == tuple(
        given[f"POSTGRES_{name}"] for name in ("USER", "PASSWORD", "DB")
    )


@pytest.mark.parametrize("name", [name for name in COMPOSE["services"] if name not in OURS])
def test_images_of_others_are_pinned_and_get_what_they_need(name):
    service = COMPOSE["services"][name]
    image, _, tag = service["image"].partition(":")
    assert tag and tag != "latest" and IMAGES[image]["needs"] <= set(service.get("environment", {}))
    inside = {volume.split(":")[1] for volume in service.get("volumes", [])}
    assert IMAGES[image]["keeps"] in inside
    files = re.findall(r"/\S+\.(?:yml|conf)", " ".join(service.get("command", [])))
    assert all(file in inside for file in files)


def on_this_machine(command, ports, group):
    """A container's command with the addresses of containers replaced by those of this machine."""
    words = []
    for word in command:
        for port, ours in ports.items():
            word = word.replace(f"0.0.0.0:{port}", f"127.0.0.1:{ours}")
            word = str(ours) if word == port else word
        word = "127.0.0.1" if word == "0.0.0.0" else word
        words.append(word.replace("239.74.163.", group).replace("/1", "/0"))
    return [sys.executable, "-c", "from residuum.service.cli import main; main()", *words[1:]]


def test_every_command_of_ours_starts_and_the_service_hears_every_machine(tmp_path, free_port):
    ports = {port: free_port() for port in ("8000", "5020", "5021")}
    group = f"239.{random.randint(1, 250)}.{random.randint(1, 250)}."
    settings = (
        (ROOT / "deploy" / "settings.yaml")
        .read_text()
        .replace("239.74.163.", group)
        .replace("/1", "/0")
    )
    settings = settings.replace("host: gripping-pliers", "host: 127.0.0.1").replace(
        "host: process-plant", "host: 127.0.0.1"
    )
    # in one go: ours may hold one of theirs
    settings = re.sub("|".join(ports), lambda port: str(ports[port[0]]), settings)
    (tmp_path / "settings.yaml").write_text(settings)
    key = first_start(tmp_path / "keys")
    environment = {
        name: value.replace(KEYS, str(tmp_path / "keys"))
        for name, value in OURS["residuum"]["environment"].items()
    }
    environment |= {
        "RESIDUUM_SETTINGS": str(tmp_path / "settings.yaml"),
        "RESIDUUM_DATA": str(tmp_path / "data"),
        "RESIDUUM_DATABASE": "",
        "RESIDUUM_MQTT": "",
        "PATH": "/usr/bin:/bin",
    }
    del environment["RESIDUUM_MQTT_PASSWORD_FILE"]  # without a broker it is nobody's
    processes = [
        subprocess.Popen(
            on_this_machine(service["command"], ports, group),
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        for service in LASTING.values()
    ]
    try:
        sources = wait_for_sources(f"http://127.0.0.1:{ports['8000']}/api/v1/status", key)
        assert len(sources) == 4
        assert all(source["samples"] > 0 for source in sources.values())
        assert all(process.poll() is None for process in processes)
        assert "residuum_source{" in scrape(f"http://127.0.0.1:{ports['8000']}", tmp_path / "keys")
    finally:
        for process in processes:
            process.terminate()
        status = [process.wait(120) for process in processes]
    assert set(status) <= {0, -15}


def keys_container(folder):
    """What the container with the keys says, with its volume in this folder."""
    words = [word.replace(KEYS, str(folder)) for word in OURS["keys"]["command"]]
    command = [sys.executable, "-c", "from residuum.service.cli import main; main()", *words[1:]]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout


def first_start(folder):
    """The key that the first start shows."""
    (key,) = re.findall(r"^ {4}(\S+)$", keys_container(folder), re.MULTILINE)
    return key


def test_keys_are_made_at_the_first_start_and_shown_once(tmp_path):
    key = first_start(tmp_path / "keys")
    files = {file.name: file.read_text() for file in (tmp_path / "keys").iterdir()}
    assert set(files) == {
        "api_keys",
        "metrics_key",
        "broker_password",
        "broker_users",
    } and key not in "".join(files.values())
    assert "none was made" in (again := keys_container(tmp_path / "keys")) and key not in again
    assert {file.name: file.read_text() for file in (tmp_path / "keys").iterdir()} == files
    known = ApiKeys(tmp_path / "keys" / "api_keys")
    assert (
        known.caller(key).role is Role.ENGINEER
        and known.caller(files["metrics_key"]).role is Role.MONITOR
    )


def test_the_stack_finds_the_keys_where_they_are_made():
    assert OURS["keys"]["command"][-1] == KEYS and f"keys:{KEYS}" in OURS["keys"]["volumes"]
    assert OURS["residuum"]["environment"]["RESIDUUM_API_KEYS"] == f"{KEYS}/api_keys"
    assert OURS["residuum"]["depends_on"]["keys"] == {"condition": "service_completed_successfully"}
    assert (
        OURS["residuum"]["environment"]["RESIDUUM_MQTT_PASSWORD_FILE"] == f"{KEYS}/broker_password"
    )
    for reader in ("residuum", "prometheus", "mosquitto"):
        assert f"keys:{KEYS}:ro" in COMPOSE["services"][reader]["volumes"]
    # whose volume it is when it is new
    assert f"-o residuum /var/lib/residuum {KEYS}" in (ROOT / "Dockerfile").read_text()


def test_the_broker_lets_in_the_service_and_no_stranger(tmp_path, free_port, monkeypatch):
    pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    if (mosquitto := find_program("mosquitto")) is None:
        not_here("MOSQUITTO", "the broker of the compose file")
    first_start(tmp_path / "keys")
    port, compose = free_port(), COMPOSE["services"]["mosquitto"]
    conf = (ROOT / "deploy" / "mosquitto.conf").read_text().replace("1883", f"{port} 127.0.0.1")
    (tmp_path / "mosquitto.conf").write_text(
        conf.replace("/tmp/", f"{tmp_path}/") + f"user {getpass.getuser()}\n"
    )
    places = {
        KEYS: f"{tmp_path}/keys",
        "/tmp/": f"{tmp_path}/",
        "/mosquitto/config": str(tmp_path),
        "exec mosquitto": f"exec {mosquitto}",
    }
    script = compose["command"][-1]
    assert all(theirs in script for theirs in places)
    script = re.sub("|".join(map(re.escape, places)), lambda found: places[found[0]], script)
    environment = OURS["residuum"]["environment"]
    url = environment["RESIDUUM_MQTT"].replace("mosquitto:1883", f"127.0.0.1:{port}")
    with subprocess.Popen([*compose["command"][:-1], script], stderr=subprocess.DEVNULL) as broker:
        try:
            wait_for_port(port, broker)
            password = Path(
                environment["RESIDUUM_MQTT_PASSWORD_FILE"].replace(KEYS, str(tmp_path / "keys"))
            )
            Broker(load_settings(mqtt=url, mqtt_password_file=password).broker).try_connection()
            for stranger in (f"mqtt://127.0.0.1:{port}", url.replace("@", ":guess@")):
                with pytest.raises(OSError, match="refuses the connection"):
                    Broker(broker_address(stranger)).try_connection()
        finally:
            broker.terminate()


def scrape(service, keys):
    """What Prometheus gets by its settings, with the volume of the keys in this folder."""
    (job,) = yaml.safe_load((ROOT / "deploy" / "prometheus.yml").read_text())["scrape_configs"]
    name, port = job["static_configs"][0]["targets"][0].split(":")
    assert name in OURS and port in OURS[name]["command"]
    key = Path(job["authorization"]["credentials_file"].replace(KEYS, str(keys))).read_text()
    headers = {"Authorization": f"{job['authorization']['type']} {key}"}
    with urllib.request.urlopen(
        urllib.request.Request(service + job["metrics_path"], headers=headers), timeout=30
    ) as answer:
        return answer.read().decode()


def wait_for_sources(url, key):
    # what each process compiles at its first start takes long on a busy machine
    end = time.monotonic() + 300
    request = urllib.request.Request(url, headers={"X-API-Key": key})
    while time.monotonic() < end:
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                sources = json.load(answer)["sources"]
        except OSError:
            sources = {}
        if sources and all(source["quality"] in ("good", "losing") for source in sources.values()):
            return sources
        time.sleep(0.5)
    pytest.fail(
        f"not all sources came: { {name: source['quality'] for name, source in sources.items()} }"
    )
