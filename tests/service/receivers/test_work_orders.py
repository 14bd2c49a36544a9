"""A new fault becomes one work order in SAP or Maximo, by their templates or one of ours, and its number is kept with it."""

import contextlib
import json
import queue
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmRule
from residuum.service.notifications import Notifications
from residuum.service.settings import BadSettings, load_settings
from residuum.service.storage import DiskStore
from residuum.service.store import FoundAtMachine, Outcome

SAP = "/sap/opu/odata/sap/API_MAINTNOTIFICATION/"


class Cmms:
    """A server of work orders: SAP's asks for its token and cookie, and each numbers what it takes."""

    def __init__(self, answer, sap=False):
        self.told, self.asked = queue.Queue(), []
        outer, numbers = self, iter(range(10004711, 10004799))

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                outer.asked.append((self.path, self.headers["X-CSRF-Token"]))
                self.send_response(200)
                self.send_header("X-CSRF-Token", "t0ken")
                self.send_header("Set-Cookie", "SAP_SESSIONID=s3ssion; path=/")
                self.end_headers()

            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                head = self.headers
                lets_in = (
                    head["X-CSRF-Token"] == "t0ken" and head["Cookie"] == "SAP_SESSIONID=s3ssion"
                )
                self.send_response(201 if lets_in or not sap else 403)
                self.end_headers()
                if lets_in or not sap:
                    outer.told.put((dict(head), body))
                    self.wfile.write(json.dumps(answer(next(numbers))).encode())

            def log_message(self, *_):
                """Say nothing."""

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self):
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def ordering(tmp_path):
    """A server of work orders, and a store whose alarms are told to it."""
    with contextlib.ExitStack() as stack:

        def start(answer, path="/", sap=False, rule=None, **receiver):
            cmms = Cmms(answer, sap)
            stack.callback(cmms.stop)
            receiver = {"kind": "webhook", "url": cmms.url + path, **receiver}
            notifications = Notifications(load_settings(receivers=[receiver]))
            rule = AlarmRule(**(rule or {}))
            store = DiskStore(
                tmp_path,
                f"sqlite:///{tmp_path / 'residuum.db'}",
                notifications.tell,
                lambda _asset: rule,
            )
            stack.callback(store.close)
            notifications.start(store.outbox, store.note_order)
            stack.callback(notifications.stop)
            return cmms, store, notifications

        yield start


def see(store, verdict):
    record = Record({"y": np.zeros(2)}, {"y": "V"}, 1.0)
    cause = "outer-race" if verdict == "faulty" else None
    numbers = {"rms": 3.2}, {"rms": 2.0}, {"rms": "m/s²"}
    finding = Finding("bearing", verdict, cause, *numbers, reason="-")
    store.add_window("press", record, finding)


def wait_until(condition):
    pause, left = threading.Event(), 600
    while not condition() and left:
        pause.wait(0.1)
        left -= 1
    assert condition()


def orders(store):
    return [entry.comment for entry in store.alarm_journal(1) if entry.event == "order"]


def test_sap_is_sent_a_notification_with_its_token_and_the_number_is_kept(ordering):
    cmms, store, _ = ordering(
        lambda number: {"d": {"MaintenanceNotification": str(number)}},
        path=f"{SAP}MaintenanceNotification?sap-client=100",
        sap=True,
        rule={"consequence": "severe", "time_to_respond": 60},
        template="sap-pm",
        fields={"NotificationType": "M1", "MaintenancePlanningPlant": "1010"},
        objects={"press": "210100094"},
    )
    see(store, "faulty")
    _, body = cmms.told.get(timeout=60)
    assert cmms.asked == [(f"{SAP}?sap-client=100", "Fetch")]
    raised = store.alarm(1).raised_at
    text = body.pop("MaintNotifLongTextForEdit")
    assert "Value: rms 3.2 m/s², threshold 2 m/s²" in text.splitlines()
    midnight = int(raised.replace(hour=0, minute=0, second=0, microsecond=0).timestamp() * 1000)
    assert body == {
        "NotificationType": "M1",
        "NotificationText": "press is faulty (priority high)",
        "TechnicalObject": "210100094",
        "TechObjIsEquipOrFuncnlLoc": "EAMS_EQUI",
        "MaintPriority": "1",
        "MalfunctionStartDate": f"/Date({midnight})/",
        "MalfunctionStartTime": f"PT{raised:%H}H{raised:%M}M{raised:%S}S",
        "MaintenancePlanningPlant": "1010",
    }
    wait_until(lambda: orders(store) == ["work order 10004711"])
    (entry, *_) = store.audit().items
    assert entry.action == "alarm order" and entry.detail["order"] == "10004711"


def test_a_confirmation_has_the_order_of_its_fault_where_nobody_names_another(ordering):
    _, store, _ = ordering(lambda number: {"ticketid": f"SR{number}"}, template="maximo")
    see(store, "healthy")
    for expected in ("SR10004711", "SR10004712"):
        see(store, "faulty")
        alarm = store.alarm(1)
        wait_until(lambda wanted=expected: orders(store)[:1] == [f"work order {wanted}"])
        finding = store.finding_of(alarm.window)
        observed = FoundAtMachine(Outcome.CONFIRMED)
        assert store.confirm("press", finding.id, observed).order == expected
        named = FoundAtMachine(Outcome.CONFIRMED, order="4711")
        assert store.confirm("press", finding.id, named).order == "4711"
        store.operate_alarm(1, AlarmEvent.ACKNOWLEDGE, "eva")
        see(store, "healthy")
        assert store.alarm(1).state == "normal"
    healthy = store.asset("press").last_finding
    assert store.confirm("press", healthy.id, FoundAtMachine(Outcome.CONFIRMED)).order is None


def test_maximo_is_sent_one_request_until_the_alarm_was_normal(ordering):
    cmms, store, notifications = ordering(
        lambda number: {"ticketid": str(number)}, template="maximo", fields={"siteid": "BEDFORD"}
    )
    for verdict in ("not-assessable", "faulty", "healthy", "faulty"):
        see(store, verdict)
    machine = next(each.id for each in store.alarms(active=False).items if each.kind == "machine")
    for event in (AlarmEvent.SHELVE, AlarmEvent.UNSHELVE, AlarmEvent.ACKNOWLEDGE):
        store.operate_alarm(machine, event, "eva")
    see(store, "healthy")
    see(store, "faulty")
    head, first = cmms.told.get(timeout=60)
    assert head["Properties"] == "*" and first["siteid"] == "BEDFORD"
    assert first["assetnum"] == "press" and first["reportedpriority"] == 3
    assert first["description"] == "press is faulty" and first["reportdate"].endswith("+00:00")
    again = cmms.told.get(timeout=60)[1]
    assert again["reportdate"] >= first["reportdate"]
    wait_until(lambda: notifications.receivers[0].sent >= 10)
    assert cmms.told.empty()


def test_what_was_raised_out_of_sight_is_ordered_when_it_comes_onto_the_list(ordering):
    stands = {"signal": "y", "unit": "V", "below": 1}
    cmms, store, _ = ordering(lambda _: {}, template="maximo", rule={"suppress": [stands]})
    see(store, "faulty")
    assert store.alarm(1).state == "suppressed" and cmms.told.empty()
    store.operate_alarm(1, AlarmEvent.RELEASE, "eva")
    assert cmms.told.get(timeout=60)[1]["description"] == "press is faulty"
    assert orders(store) == [], "an answer without a number"


def test_a_template_of_a_file(ordering, tmp_path):
    file = tmp_path / "ours.yaml"
    file.write_text(
        "body: {kind: fault, what: {machine: '{machine}', says: '{value} at {link}'}, p: '{priority}'}\n"
        "priorities: {none: 7}\norder: [made.0, made.number]\n"
    )
    cmms, store, _ = ordering(lambda number: {"made": {"number": number}}, template=str(file))
    see(store, "faulty")
    assert cmms.told.get(timeout=60)[1] == {
        "kind": "fault",
        "what": {"machine": "press", "says": "rms 3.2 m/s², threshold 2 m/s² at "},
        "p": 7,
    }
    wait_until(lambda: orders(store) == ["work order 10004711"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("body: {a: '{machin}'}", "{machin}: did you mean 'machine'?"),
        ("body: {a: b}\nordr: [a]", "ordr"),
        ("body: {}", "body"),
        ("- a", "the file"),
        (None, "no such file"),
    ],
)
def test_a_template_that_says_nothing_is_refused(tmp_path, text, says):
    file = tmp_path / "ours.yaml"
    if text is not None:
        file.write_text(text)
    receiver = {"kind": "webhook", "url": "http://127.0.0.1:1/", "template": str(file)}
    with pytest.raises(BadInput) as refused:
        Notifications(load_settings(receivers=[receiver]))
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_constants_without_a_template_are_refused():
    receiver = {"kind": "webhook", "url": "http://127.0.0.1:1/", "fields": {"siteid": "BEDFORD"}}
    with pytest.raises(BadSettings, match="write template: sap-pm"):
        load_settings(receivers=[receiver])
    with pytest.raises(BadInput, match="did you mean 'sap-pm'"):
        Notifications(load_settings(receivers=[{**receiver, "template": "sap_pm"}]))
