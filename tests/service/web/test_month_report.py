"""A machine's report of a month in a browser: it fits, it is legible, and it loads nothing."""

from datetime import UTC, datetime, timedelta

from playwright.sync_api import expect

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record


def test_the_report_is_legible_on_a_desk_and_on_a_phone(
    run_service, open_page, legible, monkeypatch, no_machines
):
    service = run_service(no_machines)
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    for number in range(60):
        at = datetime(2026, 11, 1, 6, tzinfo=UTC) + timedelta(hours=11 * number)
        monkeypatch.setattr("residuum.service.storage.disk_store._now", lambda at=at: at)
        size, verdict = 1.0 + (number - 30) ** 2 / 900, "faulty" if number > 50 else "healthy"
        kind = "wear" if verdict == "faulty" else None
        evidence = {
            "parameters": {
                "R": {"value": size, "unit": "ohm", "healthy": {"low": 0.9, "high": 1.2}}
            }
        }
        finding = Finding(
            "model-based",
            verdict,
            kind,
            {"deviation": size},
            {"deviation": 1.4},
            {},
            evidence,
            "worn bearing",
        )
        service.services.store.add_window("press", record, finding)
    monkeypatch.undo()
    page = open_page(f"{service.url}/api/v1/assets/press/report?month=2026-11")
    expect(page.get_by_role("heading", name="press: 2026-11")).to_be_visible()
    expect(page.locator("svg")).to_have_count(2)
    expect(page.get_by_role("row", name="wear")).to_contain_text("worn bearing")
    legible(page)
    page.set_viewport_size({"width": 390, "height": 844})
    legible(page)
