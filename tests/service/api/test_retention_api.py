"""The running service keeps to its retention rule, sweeps nothing at its start, and answers 410 for a signal that is gone."""

import os
import time

import httpx

GOOD = {
    "sample_time": 1e-3,
    "channels": {"acceleration": [0.0, 1.0] * 500},
    "units": {"acceleration": "m/s²"},
}
WINDOWS = "/api/v1/assets/press/windows"


def test_a_signal_that_was_let_go_is_gone_and_its_finding_stays(run_service, monkeypatch):
    monkeypatch.setattr("residuum.service.app._RETAIN_EVERY", 0.05)
    service = run_service(keep_bytes=0)
    orphan = service.services.settings.data / "blocks" / "2020-01-01" / "left.block"
    with httpx.Client(base_url=service.url, timeout=60) as client:
        first, second = (
            client.post(f"{WINDOWS}?diagnoser=bearing", json=GOOD).json()["window"]["id"]
            for _ in range(2)
        )
        end = time.monotonic() + 120
        while (seen := client.get(f"{WINDOWS}/{first}").json())["window"][
            "signal_let_go_at"
        ] is None:
            assert time.monotonic() < end, "nothing was let go"
            time.sleep(0.05)
        assert seen["finding"]["verdict"] in ("healthy", "faulty", "not-assessable")
        for view in ("signal", "spectrum"):
            answer = client.get(f"{WINDOWS}/{first}/{view}")
            assert (
                answer.status_code == 410
                and answer.headers["content-type"] == "application/problem+json"
            )
            assert "retention" in answer.json()["detail"] and answer.json()["type"].endswith(
                "signal-let-go"
            )
        assert client.get(f"{WINDOWS}/{second}/signal").status_code == 200
    service.stop()
    orphan.parent.mkdir()
    orphan.write_bytes(b"half a block")
    os.utime(orphan, (time.time() - 3600,) * 2)
    service.start()
    assert orphan.exists(), "beside another database every block would be an orphan"
