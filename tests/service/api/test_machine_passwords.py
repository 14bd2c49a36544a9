"""The password of a machine's broker is shown to nobody, and is kept when the settings come back as they were shown."""

import httpx
import pytest

pytest.importorskip(
    "google.protobuf", reason="the extra 'sparkplug' is not installed: its passwords were not tried"
)

from residuum.service.broker import with_hidden_password
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import SourceSettings

SECRET = "se:cr@t"
METRICS = "{node: Plant/Press, streams: {s: {sample_time: 0.1, channels: {acceleration: {metric: a, unit: m/s²}}}}}"


@pytest.fixture
def asked(free_port):
    source = {
        "kind": "sparkplug",
        "channel": f"mqtt://eva:{SECRET}@127.0.0.1:{free_port()}",
        "map": "metrics.yaml",
    }
    window = {"cut": "sliding", "length": 10, "step": 10}
    return {
        "diagnoser": "bearing",
        "window": window,
        "sources": [source],
        "maps": {"metrics.yaml": METRICS},
    }


def test_a_broker_s_password_is_hidden_and_kept(run_service, asked):
    service = run_service()
    given = asked["sources"][0]["channel"]
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        answer = client.put("/assets/press/machine", json=asked)
        assert answer.status_code == 200, answer.text
        hidden = given.replace(SECRET, "***")
        assert answer.json()["settings"]["sources"][0]["channel"] == hidden
        for path in (
            "/assets/press/machine",
            "/models/press.machine/versions/1",
            "/status",
            "/sources",
        ):
            shown = client.get(path)
            assert SECRET not in shown.text, path
        longer = {"cut": "sliding", "length": 20, "step": 20}
        back = asked | {"sources": [asked["sources"][0] | {"channel": hidden}], "window": longer}
        assert client.put("/assets/press/machine", json=back).status_code == 200
        assert service.services.pipeline.machine("press").sources[0].channel == given
        elsewhere = back | {
            "sources": [back["sources"][0] | {"channel": "mqtt://eva:***@evil.example"}]
        }
        as_can = back | {"sources": [{"kind": "can", "channel": hidden, "map": "metrics.yaml"}]}
        for asset, what in (("press", elsewhere), ("press", as_can), ("other", back)):
            refused = client.put(f"/assets/{asset}/machine", json=what)
            assert (
                400 <= refused.status_code < 500
                and "sources[0].channel" in refused.json()["detail"]
            )
    service.stop()
    service.start()
    assert service.services.pipeline.machine("press").sources[0].channel == given, (
        "the document is kept whole"
    )


def test_the_name_of_an_opc_ua_source_has_no_password(tmp_path):
    pytest.importorskip("asyncua")
    file = tmp_path / "nodes.yaml"
    file.write_text("{streams: {s: {sample_time: 0.1, channels: {u: {node: ns=2;s=u}}}}}")
    settings = SourceSettings(
        kind="opcua", channel="opc.tcp://eva:secret@plant:4840", map=str(file)
    )
    assert SOURCES["opcua"](settings, lambda b: True).name == "opcua:opc.tcp://eva:***@plant:4840"


def test_addresses_without_a_password_are_shown_as_they_are():
    for address in (
        "mqtt://broker/plant",
        "mqtt://eva@broker",
        "udp_multicast:239.74.163.2:43113",
        "opc.tcp://plant:4840/a:b@c",
    ):
        assert with_hidden_password(address) == address
