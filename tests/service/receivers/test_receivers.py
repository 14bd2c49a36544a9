"""Alarms reach people and messengers by every kind of receiver: from one queue, in order, and no receiver holds up another."""

import base64
import contextlib
import hashlib
import hmac
import json
import queue
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx
import numpy as np
import pytest

from benchmarks.certificates import certificate_and_key
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.cli import run
from residuum.service.notifications import Notifications, receivers_of
from residuum.service.receivers import RECEIVERS
from residuum.service.receivers.receiver_settings import Refused
from residuum.service.settings import BadSettings, load_settings
from residuum.service.storage import DiskStore
from tests.service.receivers.mail_server import MailServer

SECRET = "T0/B0/s3cret-path"
PEOPLE = ["eva@plant.example", "adam@plant.example"]


class Hook:
    """An HTTP server that answers with the given statuses, then 200, and keeps head and body of what it took."""

    def __init__(self, statuses=(), says=b"ok"):
        self.told, answers = queue.Queue(), list(statuses)
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                status = answers.pop(0) if answers else 200
                if status == 200:
                    outer.told.put((dict(self.headers), body))
                self.send_response(status)
                self.send_header("Content-Length", str(len(says)))
                self.end_headers()
                self.wfile.write(says)

            def log_message(self, *_):
                """Say nothing."""

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/{SECRET}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def next(self):
        return json.loads(self.told.get(timeout=60)[1])

    def stop(self):
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def hook_of():
    with contextlib.ExitStack() as stack:

        def start(*given, of=Hook, **named):
            server = of(*given, **named)
            stack.callback(server.stop)
            return server

        yield start


@pytest.fixture
def telling(tmp_path):
    """A store whose alarms are told to these receivers, as a service does it."""
    with contextlib.ExitStack() as stack:

        def start(*receivers, **settings):
            settings = load_settings(receivers=list(receivers), **settings)
            notifications = Notifications(settings)
            store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}", notifications.tell)
            stack.callback(store.close)
            notifications.start(store.outbox)
            stack.callback(notifications.stop)
            return store, notifications

        yield start


def see(store, verdict, rms=3.214, asset="press"):
    record = Record({"y": np.zeros(2)}, {"y": "V"}, 1.0)
    finding = Finding(
        "bearing",
        verdict,
        "outer-race" if verdict == "faulty" else None,
        {"rms": rms, "kurtosis": 9.0},
        {"rms": 2.0, "kurtosis": 8.0},
        {"rms": "m/s²", "kurtosis": ""},
        reason="outer race: <b> & _damage_",
    )
    return store.add_window(asset, record, finding)


def mail(server, **more):
    return {
        "kind": "email",
        "host": "127.0.0.1",
        "port": server.port,
        "from": "residuum@plant.example",
        "to": PEOPLE,
        "security": "none",
        **more,
    }


def test_every_kind_is_told_the_same_changes_in_order(telling, hook_of):
    server = hook_of(of=MailServer)
    hooks = {kind: hook_of() for kind in ("webhook", "teams", "slack")}
    receivers = [{"kind": kind, "url": hook.url} for kind, hook in hooks.items()]
    assert {receiver["kind"] for receiver in receivers} | {"email"} == set(RECEIVERS)
    public = {"public_url": "https://plant.example/", "oidc_issuer": "https://id.example/"}
    store, notifications = telling(*receivers, mail(server), **public)
    for verdict in ("faulty", "healthy"):
        see(store, verdict)
    page = "https://plant.example/#/machines/press"
    since = f"{store.alarm(1).raised_at:%Y-%m-%d %H:%M:%S} UTC"
    facts = {
        "Machine": "press",
        "What": "outer race: <b> & _damage_",
        "Since": since,
        "Priority": "none",
        "Value": "rms 3.214 m/s², threshold 2 m/s²",
    }
    for title in ("press is faulty", "press is no longer faulty"):
        to, message = server.told.get(timeout=60)
        assert to == PEOPLE and message["Subject"] == title
        assert message["From"] == "residuum@plant.example" and message["Message-ID"]
        lines = message.get_content().splitlines()
        assert [f"{name}: {value}" for name, value in facts.items()] == lines[2:7]
        assert lines[-1] == page

        slack = hooks["slack"].next()
        fields = dict(field["text"].split("\n") for field in slack["blocks"][1]["fields"])
        assert slack["blocks"][0]["text"]["text"] == slack["text"] == title
        assert fields["*What*"] == "outer race: &lt;b&gt; &amp; _damage_"
        assert fields["*Value*"] == facts["Value"] and page in slack["blocks"][-1]["text"]["text"]

        card = hooks["teams"].next()["attachments"][0]
        assert card["contentType"] == "application/vnd.microsoft.card.adaptive"
        runs = [[run["text"] for run in line["inlines"]] for line in card["content"]["body"]]
        assert runs[0] == [title] and card["content"]["actions"][0]["url"] == page
        assert dict(map(tuple, runs[1:6])) == {f"{name}: ": value for name, value in facts.items()}
    plain = [hooks["webhook"].next() for _ in range(2)]
    assert [(each["event"], each["change"], each["notice"]) for each in plain] == [
        ("alarm", "raise", 1),
        ("alarm", "clear", 2),
    ]
    assert plain[0]["exceeded"] == {
        "indicator": "rms",
        "value": 3.214,
        "threshold": 2.0,
        "unit": "m/s²",
    }
    assert notifications.troubles() == {}


def test_a_receiver_is_told_the_machines_and_priorities_that_it_names(telling, hook_of):
    hooks = [hook_of() for _ in range(3)]
    named = [{}, {"machines": ["hall-1.*", "press"]}, {"priorities": ["high", "medium"]}]
    receivers = [
        {"kind": "webhook", "url": hook.url, **which}
        for hook, which in zip(hooks, named, strict=True)
    ]
    store, notifications = telling(*receivers)
    for asset in ("hall-2.press", "hall-1.press", "press"):
        see(store, "faulty", asset=asset)
    assert [hooks[0].next()["asset"] for _ in range(3)] == ["hall-2.press", "hall-1.press", "press"]
    assert [hooks[1].next()["asset"] for _ in range(2)] == ["hall-1.press", "press"]
    # those of no priority are told to who names none
    wait_until(lambda: [each.sent for each in notifications.receivers] == [3, 2, 0])
    _, of_hall, urgent = receivers_of(load_settings(receivers=receivers))
    assert urgent.wants({"asset": "press", "priority": "medium"})
    assert not urgent.wants({"asset": "press", "priority": "low"})
    flood = {"kind": "flood", "phase": "begins", "raised": 20}
    assert of_hall.wants(flood) and urgent.wants(flood)


def test_a_webhook_is_signed_as_standard_webhooks_has_it(telling, hook_of, tmp_path):
    hook = hook_of(statuses=[503])
    key = b"0123456789abcdefghijklmn"
    (tmp_path / "secret").write_text(f"whsec_{base64.b64encode(key).decode()}\n")
    (tmp_path / "apikey").write_text("k3y\n")
    store, _ = telling(
        {
            "kind": "webhook",
            "url": hook.url,
            "signing_secret_file": str(tmp_path / "secret"),
            "header_files": {"apikey": str(tmp_path / "apikey")},
            "user": "eva",
            "password": "p",
        }
    )
    see(store, "faulty")
    head, body = hook.told.get(timeout=60)
    head = {name.lower(): value for name, value in head.items()}
    content = f"{head['webhook-id']}.{head['webhook-timestamp']}.".encode() + body
    signature = base64.b64encode(hmac.digest(key, content, hashlib.sha256)).decode()
    assert head["webhook-signature"] == f"v1,{signature}"
    assert head["apikey"] == "k3y"
    assert head["authorization"] == f"Basic {base64.b64encode(b'eva:p').decode()}"


@pytest.mark.parametrize("security", ["starttls", "tls"])
def test_mail_goes_by_tls_with_a_login_and_to_no_server_of_another_authority(
    telling, hook_of, tmp_path, security
):
    folder = tmp_path / "certificates"
    folder.mkdir()
    authority, another = (certificate_and_key(folder, name) for name in ("authority", "another"))
    certificate = certificate_and_key(folder, "mail", by=authority)
    login = ("eva", "hunter2")
    server = hook_of(of=MailServer, certificate=certificate, tls=security == "tls", login=login)
    (tmp_path / "password").write_text("hunter2\n")
    entered = {"user": "eva", "password_file": str(tmp_path / "password"), "security": security}
    settings = mail(server, **entered, ca=str(authority[0]))
    store, _ = telling(settings)
    see(store, "faulty")
    assert server.told.get(timeout=60)[1]["Subject"] == "press is faulty"
    assert ("AUTH", True) in server.seen and ("AUTH", False) not in server.seen
    (receiver,) = receivers_of(load_settings(receivers=[{**settings, "ca": str(another[0])}]))
    with pytest.raises(OSError, match="certificate verify failed"):
        receiver.opened(None)("alarm", {"asset": "press", "state": "normal"})


def test_a_server_without_starttls_is_told_nothing(telling, hook_of):
    server = hook_of(of=MailServer)
    (receiver,) = receivers_of(load_settings(receivers=[mail(server, security="starttls")]))
    with pytest.raises(OSError, match="STARTTLS"):
        receiver.try_connection()
    assert {verb for verb, _ in server.seen} <= {"EHLO", "QUIT"}


def test_who_refuses_for_good_is_told_and_holds_up_nobody(telling, hook_of, log_lines):
    hook = hook_of()
    deaf = hook_of(statuses=[410] * 2, says=f"no such hook /{SECRET}".encode())
    server = hook_of(of=MailServer, replies={"MAIL": ["550 we know you not", "", ""]})
    store, notifications = telling(
        {"kind": "slack", "url": deaf.url, "name": "shift"},
        {"kind": "teams", "url": hook.url},
        mail(server),
    )
    for verdict in ("faulty", "healthy"):
        see(store, verdict)
    hook.next(), hook.next()
    assert server.told.get(timeout=60)[1]["Subject"] == "press is no longer faulty"
    shift, _, people = notifications.receivers
    wait_until(lambda: shift.dropped == 2 and people.sent == 1)
    told = notifications.troubles()
    assert set(told) == {"shift"} and "status 410: no such hook ***" in told["shift"]
    assert people.dropped == 1 and people.trouble is None
    assert "550 we know you not" in str(log_lines) and SECRET not in str(log_lines) + str(told)
    see(store, "faulty")
    wait_until(lambda: notifications.troubles() == {})


def test_an_answer_that_repeats_a_secret_is_told_without_it(telling, hook_of):
    echo = hook_of(statuses=[400], says=f"k3y-s3cret, eva:pa55-s3cret, /{SECRET}".encode())
    entered = {"headers": {"apikey": "k3y-s3cret"}, "user": "eva", "password": "pa55-s3cret"}
    (receiver,) = receivers_of(
        load_settings(receivers=[{"kind": "webhook", "url": echo.url, **entered}])
    )
    with pytest.raises(Refused) as refused:
        receiver.opened(None)("alarm", {})
    assert str(refused.value) == "status 400: ***, eva:***, ***"


def test_who_has_a_message_already_gets_it_no_second_time(telling, hook_of):
    server = hook_of(of=MailServer, replies={"RCPT": ["", "451 greylisted", "", "", "550 gone"]})
    store, notifications = telling(mail(server))
    see(store, "faulty")
    told = [server.told.get(timeout=60) for _ in range(2)]
    assert [to for to, _ in told] == [[PEOPLE[0]], [PEOPLE[1]]]
    assert told[0][1]["Message-ID"] == told[1][1]["Message-ID"]
    see(store, "healthy")
    assert server.told.get(timeout=60)[0] == [PEOPLE[0]]
    wait_until(lambda: notifications.receivers[0].dropped == 1)
    assert f"{PEOPLE[1]}: 550 gone" in notifications.troubles()["email 127.0.0.1"]


def test_two_of_one_host_are_told_apart(telling, hook_of):
    first = hook_of(statuses=[404])
    other = {"kind": "slack", "url": f"{first.url}/other"}
    store, notifications = telling({"kind": "slack", "url": first.url}, other)
    assert [receiver.name for receiver in notifications.receivers] == [
        "slack http://127.0.0.1 (1)",
        "slack http://127.0.0.1 (2)",
    ]
    see(store, "faulty")
    wait_until(lambda: len(notifications.troubles()) == 1)


def test_too_many_requests_are_no_refusal(telling, hook_of):
    hook = hook_of(statuses=[429, 408])
    store, notifications = telling({"kind": "slack", "url": hook.url})
    see(store, "faulty")
    assert hook.next()["text"] == "press is faulty"
    assert notifications.receivers[0].dropped == 0


def test_what_waits_for_a_webhook_is_told_when_it_becomes_a_receiver(tmp_path, telling, hook_of):
    hook = hook_of()
    url = f"sqlite:///{tmp_path / 'residuum.db'}"
    store = DiskStore(tmp_path, url)
    (before,) = receivers_of(load_settings(webhooks=[hook.url]))
    store.outbox.register(before.address())
    see(store, "faulty")
    store.close()
    telling({"kind": "webhook", "url": hook.url, "signing_secret": "x"})
    assert hook.next()["state"] == "unacknowledged"


@pytest.mark.parametrize(
    ("receiver", "says"),
    [
        ({"kind": "emial"}, "did you mean 'email'?"),
        ({}, "known are webhook, email, teams, slack"),
        ({"kind": "slack"}, "write url: or url_file:"),
        ({"kind": "slack", "url": "s3cret://x"}, "must be https"),
        ({"kind": "slack", "url": "https://eva:s3cret@x/"}, "without a user"),
        ({"kind": "teams", "url": "https://x/", "urll": "s3cret"}, "did you mean 'url'?"),
        ({"kind": "webhook", "url": "https://x/", "password": "s3cret"}, "not enough"),
        ({"kind": "webhook", "url": "https://x/", "headers": {"a b": "s3cret"}}, "letters"),
        ({"kind": "email", "host": "x", "from": "a@b", "to": ["s3cret"]}, "must be an address"),
        ({"kind": "email", "host": "x", "from": "a@b", "to": ["a@b\ns3cret@x"]}, "an address"),
        (
            {"kind": "email", "host": "x", "from": "a@b", "to": ["a@b"], "user": "e"}
            | {"password": "s3cret", "security": "none"},
            "write starttls",
        ),
    ],
)
def test_receivers_that_cannot_be_are_refused_without_their_secrets(receiver, says):
    with pytest.raises(BadSettings) as refused:
        load_settings(receivers=[receiver])
    assert says in str(refused.value) and "s3cret" not in str(refused.value)
    assert "\n" not in str(refused.value)


def test_two_that_are_one_and_files_that_are_none_are_refused(tmp_path):
    twice = load_settings(
        webhooks=["http://127.0.0.1:1/s3cret"],
        receivers=[{"kind": "webhook", "url": "http://127.0.0.1:1/s3cret"}],
    )
    with pytest.raises(BadInput, match="there are two with this address") as refused:
        Notifications(twice)
    assert "s3cret" not in str(refused.value)
    (tmp_path / "url").write_text("not an address s3cret\n")
    (tmp_path / "empty").write_text("\n")
    for file, says in (("url", "must be https"), ("none", "cannot be read"), ("empty", "is empty")):
        receiver = {"kind": "slack", "url_file": str(tmp_path / file)}
        with pytest.raises(BadInput, match=says) as refused:
            Notifications(load_settings(receivers=[receiver]))
        assert "s3cret" not in str(refused.value)


def test_health_settings_and_doctor_tell_of_receivers_and_no_secret(
    run_service, hook_of, tmp_path, capsys
):
    deaf = hook_of(statuses=[404] * 9)
    server = hook_of(of=MailServer, login=("eva", "hunter2"))
    receivers = [
        {"kind": "slack", "url": deaf.url},
        mail(server, user="eva", password="wrong-s3cret"),
    ]
    service = run_service(receivers=receivers)
    see(service.services.store, "faulty")
    wait_until(lambda: len(service.services.receiver_troubles()) == 2)
    ready = httpx.get(f"{service.url}/api/v1/health/ready", timeout=60)
    told = ready.json()["receivers"]
    assert ready.status_code == 200 and ready.json()["status"] == "degraded"
    assert "status 404" in told["slack http://127.0.0.1"] and "535" in told["email 127.0.0.1"]
    settings = httpx.get(f"{service.url}/api/v1/settings", timeout=60).text
    file = tmp_path / "residuum.yaml"
    file.write_text(json.dumps({"receivers": receivers}))
    run(["doctor", "--data", str(tmp_path / "new"), "--settings", str(file), "--json"])
    out = capsys.readouterr().out
    checks = {check["name"]: check for check in json.loads(out)["checks"]}
    assert checks["receiver slack http://127.0.0.1"]["ok"]
    assert not checks["receiver email 127.0.0.1"]["ok"]
    assert "535" in checks["receiver email 127.0.0.1"]["says"]
    for text in (ready.text, settings, out):
        assert "s3cret" not in text and "kind" in settings


def wait_until(condition):
    done, end = threading.Event(), 600
    while not condition() and end:
        done.wait(0.1)
        end -= 1
    assert condition()


def test_a_flood_is_one_message():
    from residuum.service.receivers.alarm_text import alarm_text

    alarms = [{"asset": f"m{k}", "state": "unacknowledged", "message": "worn"} for k in range(12)]
    flood = {"kind": "flood", "phase": "begins", "raised": 12, "alarms": alarms}
    flood |= {"began_at": "2026-03-01T10:00:00+00:00", "ended_at": None}
    text = alarm_text("flood", flood, "https://plant.example/")
    assert text.title == "Flood of alarms: 12 so far" and text.link == "https://plant.example/"
    assert text.facts[0] == ("Since", "2026-03-01 10:00:00 UTC")
    assert text.facts[1] == ("m0", "unacknowledged: worn") and text.facts[-1] == ("And", "2 more")
