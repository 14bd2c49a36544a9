"""Alarms over HTTP: put aside and taken back, the rule of the settings, rates, and the trail that is left."""

import httpx
import numpy as np

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record


def test_an_alarm_is_put_aside_taken_back_latched_and_reset(run_service):
    service = run_service(alarms={"latch": True})

    def see(verdict):
        record = Record({"y": np.zeros(4)}, {"y": "V"}, 1.0)
        service.services.store.add_window("press", record, Finding("bearing", verdict, reason="-"))

    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:

        def ask(verb, status=200):
            answer = client.post(f"/alarms/1/{verb}", json={"comment": "because"})
            assert answer.status_code == status, answer.text
            return answer.json().get("state")

        see("faulty")
        assert ask("suppress") == "suppressed" and ask("unshelve", 409) is None
        assert ask("release") == "unacknowledged"
        assert ask("remove-from-service") == "out-of-service"
        assert ask("return-to-service") == "unacknowledged"
        see("healthy")
        assert client.get("/alarms").json()["items"][0]["state"] == "unacknowledged"
        assert (
            ask("acknowledge") == "acknowledged"
            and ask("reset") == "normal"
            and ask("reset", 409) is None
        )
        rates = client.get("/alarms/rates").json()
        assert (rates["last_day"], rates["flood"], rates["standing"]) == (1, False, {"normal": 1})
        trail = client.get("/audit", params={"limit": 3}).json()
        assert [entry["action"] for entry in trail["items"]] == [
            "alarm reset",
            "alarm acknowledge",
            "alarm clear",
        ]
        assert trail["items"][0]["by"] == "local" and trail["next_cursor"]
