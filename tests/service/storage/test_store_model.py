"""The store against a model of a page: idempotency keys, the outbox and versions of models, in any order, across restarts.

The model is plain dictionaries and lists. Whatever is done in whatever order, by two processes on one database: a key stores one
window and always gives that one; a receiver is told every change of an alarm and every finding since it was known, each in order
and, once it said that it was told, never again; versions of a model are numbered without gaps and keep their content.
"""

import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, IllegalTransition
from residuum.service.storage import DiskStore
from residuum.service.store import Conflict

ASSETS, KEYS, CONTENTS = (
    st.sampled_from("ab"),
    st.sampled_from(["k1", "k2", "k3", None]),
    st.integers(1, 3),
)
RECEIVERS = {"http://hook": False, "mqtt://broker": True}


class StoreAgainstModel(RuleBasedStateMachine):
    """Two processes on one database, as two stores."""

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.stores = [self.opened(), self.opened()]
        self.windows, self.by_key = {}, {}
        self.models = {}
        self.alarms_untold, self.findings_untold = {}, {}

    def opened(self):
        return DiskStore(self.folder, f"sqlite:///{self.folder / 'residuum.db'}", self.announced)

    def announced(self, kind, payload):
        if kind == "alarm":
            for waiting in self.alarms_untold.values():
                waiting.append((payload["id"], payload["state"].value))
        elif kind == "finding":
            for waiting in self.findings_untold.values():
                waiting.append(payload["id"])

    @rule(
        which=st.integers(0, 1),
        asset=ASSETS,
        verdicts=st.lists(st.booleans(), min_size=2, max_size=6),
    )
    def store_windows_without_keys(self, which, asset, verdicts):
        for faulty in verdicts:
            self.store_a_window(which, asset, None, 1, faulty)

    @rule(which=st.integers(0, 1), asset=ASSETS, key=KEYS, content=CONTENTS, faulty=st.booleans())
    def store_a_window(self, which, asset, key, content, faulty):
        record = Record({"y": [float(content), 0.0]}, {"y": "V"}, 1.0)
        finding = Finding("bearing", "faulty" if faulty else "healthy", reason="-")
        known = self.by_key.get((asset, key)) if key else None
        if known is not None and known[1] != content:
            with pytest.raises(Conflict, match="was used for another window"):
                self.stores[which].add_window(asset, record, finding, key, str(content))
            return
        number = self.stores[which].add_window(asset, record, finding, key, str(content))
        if known is not None:
            assert number == known[0]
            return
        assert number not in self.windows
        self.windows[number] = (asset, content)
        if key:
            self.by_key[asset, key] = (number, content)

    @rule(which=st.integers(0, 1), event=st.sampled_from(list(AlarmEvent)[2:]))
    def handle_an_alarm(self, which, event):
        for alarm in self.stores[which].alarms(active=False).items[:1]:
            before = [list(waiting) for waiting in self.alarms_untold.values()]
            try:
                changed = self.stores[which].operate_alarm(alarm.id, event)
                assert self.stores[which].alarm_journal(alarm.id)[0].state == changed.state
            except IllegalTransition:
                assert [list(waiting) for waiting in self.alarms_untold.values()] == before
                assert self.stores[which].alarm(alarm.id) == alarm

    @rule(
        which=st.integers(0, 1),
        name=st.sampled_from(["drive", "oven"]),
        content=st.binary(max_size=8),
    )
    def add_a_version(self, which, name, content):
        kept = self.models.setdefault(name, [])
        kept.append(content)
        assert self.stores[which].add_model_version(name, "physical", content).number == len(kept)

    @initialize(
        which=st.integers(0, 1), addresses=st.sampled_from([["mqtt://broker"], list(RECEIVERS)])
    )
    def register_receivers(self, which, addresses):
        for address in addresses:
            self.register_a_receiver(which, address)

    @rule(which=st.integers(0, 1), address=st.sampled_from(list(RECEIVERS)))
    def register_a_receiver(self, which, address):
        self.stores[which].outbox.register(address, findings=RECEIVERS[address])
        self.alarms_untold.setdefault(address, [])
        if RECEIVERS[address]:
            self.findings_untold.setdefault(address, [])

    @precondition(lambda self: self.alarms_untold)
    @rule(which=st.integers(0, 1), heard=st.booleans(), data=st.data())
    def tell_of_an_alarm(self, which, heard, data):
        address = data.draw(st.sampled_from(sorted(self.alarms_untold)))
        outbox, waiting = self.stores[which].outbox, self.alarms_untold[address]
        self.stores[1 - which].outbox.release()
        receiver = outbox.register(address, findings=RECEIVERS[address])
        notice = outbox.next(receiver)
        assert (notice is None) == (not waiting)
        if notice is not None:
            assert (notice.alarm["id"], notice.alarm["state"]) == waiting[
                0
            ] and notice.passed_over == 0
            assert self.stores[1 - which].outbox.next(receiver) is None, (
                "another process tells it now"
            )
            if heard:
                outbox.told(receiver, notice)
                waiting.pop(0)

    @precondition(lambda self: self.findings_untold)
    @rule(which=st.integers(0, 1), heard=st.integers(1, 5), data=st.data())
    def tell_of_findings(self, which, heard, data):
        address = data.draw(st.sampled_from(sorted(self.findings_untold)))
        outbox, waiting = self.stores[which].outbox, self.findings_untold[address]
        self.stores[1 - which].outbox.release()
        receiver = outbox.register(address, findings=True)
        batch = outbox.findings(receiver)
        assert [finding.id for finding in batch.findings] == waiting[:100] and batch.lost == 0
        outbox.told_findings(receiver, waiting[:heard])
        del waiting[:heard]

    @rule(which=st.integers(0, 1))
    def restart(self, which):
        self.stores[which].outbox.release()
        self.stores[which].close()
        self.stores[which] = self.opened()

    @invariant()
    def all_is_there_in_both(self):
        for store in self.stores:
            held = {
                window.id: window.asset
                for asset in store.assets().items
                for window in store.windows(asset.id, limit=500).items
            }
            assert held == {number: asset for number, (asset, _) in self.windows.items()}
            for name, contents in self.models.items():
                assert [
                    store.model_content(name, number + 1) for number in range(len(contents))
                ] == contents
        if self.windows:
            number, (asset, content) = max(self.windows.items())
            assert self.stores[0].window_record(asset, number)["y"][0] == content

    def teardown(self):
        for store in self.stores:
            store.close()
        shutil.rmtree(self.folder)


StoreAgainstModel.TestCase.settings = settings(
    max_examples=12,
    stateful_step_count=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
TestStoreAgainstModel = StoreAgainstModel.TestCase
