"""Which files of the server a machine that is added over HTTP may read: those below one folder, or none."""

import httpx

MAP = """\
streams:
  signals:
    sample_time: 0.1
    time: {column: time, form: seconds}
    channels: {acceleration: {column: a, unit: m/s²}}
"""


def asked(channel):
    return {
        "diagnoser": "bearing",
        "window": {"cut": "sliding", "length": 10, "step": 10},
        "sources": [{"kind": "file", "channel": channel, "map": "columns.yaml"}],
        "maps": {"columns.yaml": MAP},
    }


def test_a_machine_that_is_added_reads_files_below_the_folder_alone(run_service, tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "press.csv").write_text("time,a\n")
    service = run_service(growing_files=folder)
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        described = client.post(
            "/bus-descriptions", json={"kind": "columns", "name": "columns", "text": MAP}
        )
        assert described.json()["streams"][0]["channels"] == {"acceleration": "m/s²"}
        for outside in ("file:/etc/passwd", "file:../press.csv", "file:/etc/no-such-file"):
            refused = client.put("/assets/press/machine", json=asked(outside))
            assert refused.status_code == 422, refused.text
            assert "growing_files" in refused.json()["detail"]
            assert client.get("/assets/press/machine").status_code == 404
        added = client.put("/assets/press/machine", json=asked("file:press.csv"))
        assert added.status_code == 200, added.text
        assert added.json()["settings"]["sources"][0]["channel"] == f"file:{folder}/press.csv"
    service.stop()
    service.start()
    (source,) = service.services.pipeline.machine("press").sources
    assert source.channel == f"file:{folder}/press.csv"


def test_without_the_setting_no_file_is_read(run_service):
    service = run_service()
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        refused = client.put("/assets/press/machine", json=asked("file:/etc/passwd"))
        assert refused.status_code == 422
        assert "the setting growing_files names no folder" in refused.json()["detail"]
