"""The method that decides for a machine: chosen over HTTP, kept, used from the next window on; findings hold both results."""

import httpx
import numpy as np
import pytest

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.identification.errors import BadInput
from residuum.service.machines.baselines import (
    choose_method,
    chosen_method,
    deciding_method,
    train_baseline,
)
from residuum.service.work.worker_pool import parts_of

ADDRESS = "/api/v1/assets/plant/method"


def silent(*_told):
    return None


@pytest.fixture(scope="module")
def case():
    return RobustResidual.examples()[0]


@pytest.fixture(scope="module")
def service(run_service, case, tmp_path_factory):
    """A machine with a baseline of the robust residual, trained so that the default method decides."""
    service = run_service()
    file = tmp_path_factory.mktemp("baseline") / "b"
    RobustResidual().fit(case.training).save(file)
    service.services.store.add_model_version("plant", "baseline", file.read_bytes())
    service.services.store.ensure_asset("plant", diagnoser="robust-residual")
    return service


@pytest.fixture(scope="module")
def client(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield client


@pytest.fixture(scope="module")
def overlooked(case):
    """A faulty record that the source's method calls healthy."""
    trained = RobustResidual().fit(case.training)
    source = trained.with_settings(method="source")
    return next(record for record in case.faulty if source.score(record).verdict.value == "healthy")


def body(record):
    channels = {
        name: [None if np.isnan(v) else float(v) for v in record[name]] for name in record.names
    }
    return {
        "sample_time": record.sample_time,
        "t0": record.t0,
        "channels": channels,
        "units": dict(record.units),
    }


def found(client, record, **query):
    answer = client.post("/api/v1/assets/plant/windows", params=query, json=body(record))
    assert answer.status_code == 201, answer.text
    return answer.json()["finding"]


def test_the_chosen_method_decides_from_the_next_window_on_and_both_are_told(
    client, service, overlooked
):
    assert client.get(ADDRESS).json() == {
        "diagnoser": "robust-residual",
        "methods": ["default", "source"],
        "chosen": None,
    }
    assert found(client, overlooked)["verdict"] == "faulty"
    assert client.put(ADDRESS, json={"method": "source"}).json()["chosen"] == "source"
    by_source = found(client, overlooked)
    assert by_source["verdict"] == "healthy" and by_source["evidence"]["method"] == "source"
    assert by_source["evidence"]["default_method"]["verdict"] == "faulty"
    # a window's own wish stands before
    assert found(client, overlooked, method="default")["verdict"] == "faulty"
    service.stop()
    service.start()  # kept
    with httpx.Client(base_url=service.url, timeout=60) as anew:
        assert anew.get(ADDRESS).json()["chosen"] == "source"
        assert found(anew, overlooked)["evidence"]["method"] == "source"
        assert anew.get("/api/v1/models").json()["items"][0]["model"] == "plant"
        assert len(anew.get("/api/v1/models").json()["items"]) == 1  # the choice is no model
        assert anew.put(ADDRESS, json={"method": None}).json()["chosen"] is None
        assert found(anew, overlooked)["verdict"] == "faulty"


def test_what_cannot_decide_is_refused(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        service.services.store.ensure_asset("press", diagnoser="bearing")
        service.services.store.ensure_asset("bare")
        one = client.put("/api/v1/assets/press/method", json={"method": "source"})
        assert one.status_code == 422 and "must be default" in one.json()["detail"]
        assert client.put(ADDRESS, json={"method": "better"}).status_code == 422
        assert client.get("/api/v1/assets/nobody/method").status_code == 404
        assert (
            "no diagnoser yet"
            in client.put("/api/v1/assets/bare/method", json={"method": "source"}).json()["detail"]
        )
        assert chosen_method(service.services.store, "press") is None


@pytest.mark.parametrize("length", [56, 64])
def test_a_machine_with_a_long_name_is_judged_though_no_method_can_be_chosen_for_it(
    service, case, length
):
    store, asset = service.services.store, "p" * length
    store.add_model_version(asset, "baseline", store.model_content("plant"))
    windows = f"{service.url}/api/v1/assets/{{}}/windows?diagnoser={{}}"
    with httpx.Client(base_url=f"{service.url}/api/v1/assets/{asset}", timeout=60) as client:
        one_method = client.post(
            windows.format("b" * length, "bearing"), json=body(Bearing.examples()[0].faulty[0])
        )
        two = client.post(windows.format(asset, "robust-residual"), json=body(case.faulty[0]))
        assert (one_method.status_code, two.status_code) == (201, 201), (one_method.text, two.text)
        assert client.get("/method").json()["chosen"] is None and client.get("/limits").json() == {
            "limits": {}
        }
        refused = client.put("/method", json={"method": "source"})
        assert (
            refused.status_code == 409
            and "is longer than 55 characters" in refused.json()["detail"]
        )
        assert client.put("/limits", json={"limits": {"R": 1.0}}).status_code == 409
    assert deciding_method(store, asset, "robust-residual", "source") == "source"


def test_a_choice_for_another_diagnoser_decides_nothing(service):
    store = service.services.store
    store.ensure_asset("changed", diagnoser="robust-residual")
    choose_method(store, "changed", "source", "somebody")
    assert deciding_method(store, "changed", "robust-residual") == "source"
    assert deciding_method(store, "changed", "bearing") is None


def test_a_model_that_is_called_like_a_machines_document_is_none(service, case):
    store, faulty = service.services.store, body(case.faulty[0])
    store.add_model_version("pump", "baseline", store.model_content("plant"))
    # of a machine with this name
    store.add_model_version("pump.method", "baseline", store.model_content("plant"))
    store.add_model_version("pump.limits", "physical", b"name: pump")
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        for asset in ("pump", "pump.method"):
            stored = client.post(f"/assets/{asset}/windows?diagnoser=robust-residual", json=faulty)
            assert stored.status_code == 201, stored.text
        assert client.get("/assets/pump/method").json()["chosen"] is None
        assert client.get("/assets/pump/limits").json() == {"limits": {}}
        assert client.put("/assets/pump/method", json={"method": "source"}).status_code == 409


@pytest.mark.parametrize("ending", [".method", ".machine", ".limits"])
def test_the_names_of_a_machines_documents_are_given_to_no_model(service, ending):
    says = f"'valve{ending}' is the name of a machine's document; a model's must not end in .machine, .method, .limits"
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        added = client.post("/models", params={"name": f"valve{ending}"}, content=b"name: valve")
        saved = client.post(
            "/models/gate-drive/parameters",
            json={"parameters": {"R": {}}, "save_as": f"valve{ending}"},
        )
        for refused in (added, saved):
            assert refused.status_code == 422 and refused.json()["detail"].endswith(says), (
                refused.text
            )
        assert client.get(f"/models/valve{ending}/versions").status_code == 404


def test_a_machines_document_is_not_told_as_a_model(service):
    choose_method(service.services.store, "plant", "source", "somebody")
    with httpx.Client(base_url=f"{service.url}/api/v1/models/plant.method", timeout=60) as client:
        for path in ("/versions", "/versions/1"):
            assert client.get(path).status_code == 404
            assert (
                client.get(path).json()["detail"]
                == "model 'plant.method': there is none of this name; GET /models lists them"
            )


def test_a_baseline_is_trained_with_the_method_that_is_asked_for(case, tmp_path):
    windows = [parts_of(record) for record in case.training]
    made = train_baseline(silent, "robust-residual", windows, {}, None, {"method": "source"})
    (tmp_path / "b").write_bytes(made["baseline"])
    assert RobustResidual.load(tmp_path / "b").method == "source"
    with pytest.raises(BadInput, match="must be default"):
        train_baseline(silent, "bearing", windows, {}, None, {"method": "source"})
    assert GateActuator.methods == ("default", "source")
