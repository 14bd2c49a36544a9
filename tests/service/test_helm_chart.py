"""The Helm chart: its values, what it makes of them, and that all of it fits the service. No cluster and no Helm are started."""

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from gotpl.exts.helm import HelmTemplateEngine

from residuum.service.settings import Settings, load_settings

CHART = Path(__file__).parents[2] / "deploy" / "helm" / "residuum"
META = yaml.safe_load((CHART / "Chart.yaml").read_text())
VALUES = yaml.safe_load((CHART / "values.yaml").read_text())
SCHEMA = json.loads((CHART / "values.schema.json").read_text())
MACHINE = {
    "asset": "press",
    "diagnoser": "bearing",
    "window": {"cut": "sliding"},
    "sources": [
        {"kind": "sparkplug", "channel": "mqtt://broker", "map": "/etc/residuum-maps/press.yaml"}
    ],
}
CODE = {"RESIDUUM_CACHE": "kernels", "NUMBA_CACHE_DIR": "loops"}
FULL = {
    "settings": {"machines": [MACHINE], "keep_days": 7},
    "maps": {"press.yaml": "node: G/N\nstreams: {}\n"},
    "database": {"existingSecret": "db"},
    "mqtt": {"existingSecret": "broker"},
    "data": {"size": "5Gi", "storageClass": "fast", "accessMode": "ReadWriteMany"},
    "ingress": {
        "enabled": True,
        "className": "nginx",
        "host": "residuum.plant",
        "tlsSecret": "tls",
    },
    "nodeSelector": {"plant": "hall-1"},
    "tolerations": [{"key": "plant", "operator": "Exists"}],
}


def rendered(**given):
    """What the chart makes of values, by kind and name."""
    import jsonschema  # takes seconds to load, which every process that collects tests would spend

    values = VALUES | given
    jsonschema.validate(values, SCHEMA)
    release = {"Name": "plant", "Service": "Helm", "Namespace": "default"}
    data = {"Values": values, "Chart": {"AppVersion": META["appVersion"]}, "Release": release}
    names = [path.name for path in (CHART / "templates").iterdir() if path.suffix != ".tpl"]
    sources = {
        f"residuum/templates/{path.name}": path.read_text()
        for path in (CHART / "templates").iterdir()
    }
    engine = HelmTemplateEngine.from_sources(sources, strict=True)
    texts = {
        n: engine.render_template(
            f"residuum/templates/{n}", data | {"Template": {"BasePath": "residuum/templates"}}
        )
        for n in names
    }
    notes = texts.pop("NOTES.txt")
    made = [each for text in texts.values() for each in yaml.safe_load_all(text) if each]
    return {(each["kind"], each["metadata"]["name"]): each for each in made} | {"notes": notes}


def pods(made):
    return [
        each["spec"]["template"]["spec"] for key, each in made.items() if key[0] == "Deployment"
    ]


@pytest.mark.parametrize("given", [{}, FULL], ids=["as it stands", "everything"])
def test_what_a_pod_names_is_there_and_it_has_no_more_rights_than_it_needs(given):
    made = rendered(**given)
    assert len(pods(made)) == 1
    for pod in pods(made):
        (container,) = pod["containers"]
        assert pod["securityContext"]["runAsNonRoot"] and not pod["automountServiceAccountToken"]
        own = container["securityContext"]
        assert (
            own["readOnlyRootFilesystem"]
            and not own["allowPrivilegeEscalation"]
            and own["capabilities"] == {"drop": ["ALL"]}
        )
        assert {"cpu", "memory"} <= set(container["resources"]["limits"])
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
        assert set(mounts) == set(volumes)
        # no mount in another
        assert not any(
            a != b and b.startswith(f"{a}/") for a in mounts.values() for b in mounts.values()
        )
        for volume in volumes.values():
            if "configMap" in volume:
                assert ("ConfigMap", volume["configMap"]["name"]) in made
            if "persistentVolumeClaim" in volume:
                assert (
                    "PersistentVolumeClaim",
                    volume["persistentVolumeClaim"]["claimName"],
                ) in made


def test_compiled_code_is_kept_in_a_pod(tmp_path):
    """An emptyDir is 0777 without the sticky bit; what the pod mounts of it must be a folder that code is kept in."""
    for number, pod in enumerate(pods(rendered(**FULL))):
        (first,), (container,) = pod["initContainers"], pod["containers"]
        assert first["securityContext"] == container["securityContext"]
        (mount,) = [
            each for each in container["volumeMounts"] if each["mountPath"].startswith("/var/cache")
        ]
        (whole,) = first["volumeMounts"]
        assert (
            whole["name"] == mount["name"]
            and {"name": mount["name"], "emptyDir": {}} in pod["volumes"]
        )
        volume = tmp_path / f"volume-{number}"
        volume.mkdir()
        volume.chmod(0o777)
        made = [each.replace(whole["mountPath"], str(volume)) for each in first["args"]]
        subprocess.run(made, check=True, umask=0)
        # as the container sees it
        mounted = (volume / mount["subPath"]).rename(tmp_path / f"mounted-{number}")
        places = {each["name"]: each["value"] for each in container["env"] if each["name"] in CODE}
        assert set(places) == set(CODE) and set(places.values()) == {mount["mountPath"]}
        asked = [f"print(why_not_kept({name!r}, {variable!r}))" for variable, name in CODE.items()]
        command = [
            sys.executable,
            "-c",
            "\n".join(["from residuum.code_folder import why_not_kept", *asked]),
        ]
        here = os.environ | dict.fromkeys(CODE, str(mounted))
        assert subprocess.run(
            command, capture_output=True, text=True, check=True, env=here
        ).stdout.split() == ["None", "None"]
        assert stat.S_IMODE(mounted.stat().st_mode) == 0o700


def test_environment_and_settings_are_those_of_the_service(monkeypatch, tmp_path):
    made = rendered(**FULL)
    known = {f"RESIDUUM_{name.upper()}" for name in Settings.model_fields} | {
        "RESIDUUM_SETTINGS",
        *CODE,
    }
    for pod in pods(made):
        assert {each["name"] for each in pod["containers"][0]["env"]} <= known
    file = tmp_path / "settings.yaml"
    file.write_text(made["ConfigMap", "plant-settings"]["data"]["settings.yaml"])
    monkeypatch.setenv("RESIDUUM_SETTINGS", str(file))
    settings = load_settings()
    assert settings.machines[0].asset == "press" and settings.keep_days == 7
    assert made["ConfigMap", "plant-maps"]["data"] == FULL["maps"]
    (env,) = [
        each for each in pods(made)[0]["containers"][0]["env"] if each["name"] == "RESIDUUM_MQTT"
    ]
    assert env["valueFrom"]["secretKeyRef"] == {"name": "broker", "key": "url"}


def test_service_probes_ingress_and_labels_meet():
    made = rendered(**FULL)
    service, deployment, ingress = (
        made[kind, "plant"] for kind in ("Service", "Deployment", "Ingress")
    )
    labels = deployment["spec"]["template"]["metadata"]["labels"]
    assert (
        service["spec"]["selector"].items() <= labels.items()
        and deployment["spec"]["selector"]["matchLabels"].items() <= labels.items()
    )
    (container,) = deployment["spec"]["template"]["spec"]["containers"]
    assert container["ports"] == [{"name": "http", "containerPort": int(container["args"][-1])}]
    probes = [
        container[name]["httpGet"] for name in ("startupProbe", "livenessProbe", "readinessProbe")
    ]
    assert [probe["path"] for probe in probes] == ["/health/live", "/health/live", "/health/ready"]
    backend = ingress["spec"]["rules"][0]["http"]["paths"][0]["backend"]["service"]
    assert backend == {"name": "plant", "port": {"name": "http"}} and ingress["spec"]["tls"][0][
        "hosts"
    ] == ["residuum.plant"]
    assert "residuum-keys" in made["notes"] and ("Ingress", "plant") not in rendered()


def test_settings_that_change_start_the_service_anew():
    def mark(**given):
        return rendered(**FULL | given)["Deployment", "plant"]["spec"]["template"]["metadata"][
            "annotations"
        ]["checksum/settings"]

    assert mark() == mark() != mark(settings={"machines": [], "keep_days": 8})


def test_all_pods_are_placed_alike():
    for pod in pods(rendered(**FULL)):
        assert (
            pod["nodeSelector"] == FULL["nodeSelector"]
            and pod["tolerations"] == FULL["tolerations"]
        )
    assert not {"nodeSelector", "tolerations"} & set(pods(rendered())[0])


@pytest.mark.parametrize(
    "given",
    [
        {"servce": {}},
        {"scorers": 1},
        {"data": {"accessMode": "All"}},
        {"apiKeys": {"existingSecret": ""}},
    ],
)
def test_values_that_are_none_are_refused(given):
    from jsonschema import ValidationError

    with pytest.raises(ValidationError):
        rendered(**given)
