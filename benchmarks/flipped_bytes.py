"""Bytes that flip on the disk, in signal blocks and the database's pages: each is told or harmless, none becomes another value.

    python -m benchmarks.flipped_bytes --pages 10000 --blocks 90000

A data folder with windows, findings, alarms and what operators did with them, records, models, a history by hours and an audit
trail is written once; then one byte at a time is changed, everything is asked for that reads its page, and the byte is put back.
Told: each answer that differs is a refusal, or names the damage. Noticed at the start: an answer lacks a row, because rows are
found by what flipped, and the look through all indexes and rows, with which a start begins, names it. Another value: an answer
differs and nothing tells. Harmless: every answer is what it was. The exit status is 1 when there is another value.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, IllegalTransition
from residuum.service.storage import DiskStore, outbox
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database
from residuum.service.storage.retention import Retention
from residuum.service.storage.rows import row_checks
from residuum.service.store import StorageUnavailable

TELLS = "differs from its checksum"
Question = Callable[[], Any]


def fill(folder: Path, windows: int = 24) -> str:
    """Write a data folder with something in each table; gives the URL of its database."""
    url = f"sqlite:///{folder / 'residuum.db'}"
    store, rng = DiskStore(folder, url), np.random.default_rng(0)
    for number in range(windows):
        asset = ("press", "mill")[number % 2]
        record = Record(
            {"y": rng.normal(size=64), "u": rng.normal(size=64)},
            {"y": "m/s²", "u": "V"},
            1e-3,
            t0=float(number),
            source="bus",
        )
        verdict = ("healthy", "faulty", "not-assessable")[number // 2 % 3]
        reason = None if verdict == "faulty" else f"because of {number}"
        values = {"rms": float(rng.uniform(0.5, 9.0)), "kurtosis": float(number)}
        evidence = {"bands": rng.normal(size=8).tolist()}
        store.add_window(
            asset,
            record,
            Finding(
                "bearing",
                verdict,
                "outer" if verdict == "faulty" else None,
                values,
                {"rms": 2.5},
                {"rms": "m/s²", "kurtosis": ""},
                evidence,
                reason,
            ),
            f"key-{number}",
            "d" * 64,
        )
        if number % 8 == 3:
            for alarm in store.alarms().items:
                with suppress(IllegalTransition):
                    operate(store, alarm.id, number)
    for number in range(3):
        store.add_record(
            f"a record {number}",
            Record({"y": rng.normal(size=16)}, {"y": "V"}, 0.1, notes=(f"a note {number}",)),
        )
        store.add_model_version(
            f"model-{number % 2}", "physical", rng.bytes(300), f"note {number}", "engineer"
        )
    store.retain(Retention(math.inf, 2**40, math.inf, windows - 4))
    store.close()
    database = Database(url)
    with database.read() as connection:
        connection.exec_driver_sql("ROLLBACK")
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
    database.close()
    return url


def operate(store: DiskStore, alarm: int, number: int) -> None:
    """What an operator may do with an alarm."""
    until = datetime.now(UTC) + timedelta(days=300)
    event = AlarmEvent.SHELVE if number % 16 == 3 else AlarmEvent.ACKNOWLEDGE
    store.operate_alarm(
        alarm,
        event,
        "operator",
        f"a comment {number}",
        until if event is AlarmEvent.SHELVE else None,
    )


def questions(store: DiskStore) -> dict[str, Question]:
    """All that can be asked of a store, by name; what there is to ask of is looked up once, in the whole one."""
    long_ago, never = datetime(2000, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
    asked: dict[str, Question] = {
        "assets": lambda: listed(store.assets(limit=500)),
        "alarms": lambda: listed(store.alarms(active=False, limit=500)),
        "active alarms": lambda: listed(store.alarms(limit=500)),
        "alarm history": lambda: listed(store.alarm_history(limit=500)),
        "records": lambda: listed(store.records(limit=500)),
        "models": lambda: listed(store.models(limit=500)),
        "audit": lambda: listed(store.audit(limit=500)),
        "notices": lambda: list(notices(store)),
    }
    for asset in [each.id for each in store.assets().items]:
        asked |= {
            f"asset {asset}": lambda asset=asset: store.asset(asset).to_json(),
            f"findings {asset}": lambda asset=asset: listed(store.findings(asset, limit=500)),
            f"faulty {asset}": lambda asset=asset: listed(
                store.findings(asset, limit=500, verdict="faulty")
            ),
            f"windows {asset}": lambda asset=asset: listed(store.windows(asset, limit=500)),
            f"indicators {asset}": lambda asset=asset: store.indicators(asset).to_json(),
            f"spread {asset}": lambda asset=asset: store.indicators(
                asset, 20, (long_ago, never)
            ).to_json(),
            f"hours {asset}": lambda asset=asset: [
                each.to_json() for each in store.finding_hours(asset)
            ],
            f"between {asset}": lambda asset=asset: [
                e.to_json() for e in store.findings_between(asset, long_ago, never)
            ],
        }
        for window in [each.id for each in store.windows(asset).items][::10]:
            asked |= {
                f"window {window}": lambda asset=asset, window=window: store.window(
                    asset, window
                ).to_json(),
                f"finding {window}": lambda window=window: store.finding_of(window).to_json(),
                f"signal {window}": lambda asset=asset, window=window: said(
                    store.window_record(asset, window)
                ),
                f"key of {window}": lambda asset=asset, window=window: store.window_with_key(
                    asset, f"key-{window - 1}", "d" * 64
                ),
            }
    for alarm in [each.id for each in store.alarms(active=False).items]:
        asked[f"alarm {alarm}"] = lambda alarm=alarm: [
            store.alarm(alarm).to_json(),
            [e.to_json() for e in store.alarm_journal(alarm)],
        ]
    for record in [each.id for each in store.records().items]:
        asked[f"record {record}"] = lambda record=record: [
            store.record(record).to_json(),
            said(store.record_samples(record)),
        ]
    for model in [each.model for each in store.models().items]:
        asked[f"model {model}"] = lambda model=model: [
            [each.to_json() for each in store.model_versions(model)],
            store.model_content(model).hex(),
        ]
    return asked


def notices(store: DiskStore) -> Iterator[Any]:
    """What a receiver that knows nothing yet is told of alarms."""
    with store._database.read() as connection:
        notice = outbox.after(connection, 0)
        while notice is not None:
            yield [notice.number, notice.alarm or TELLS]
            notice = outbox.after(connection, notice.number)


def listed(page: Any) -> Any:
    """A page as its route gives it."""
    return {"items": [item.to_json() for item in page.items], "next_cursor": page.next_cursor}


def said(record: Record) -> Any:
    """All of a record."""
    about = [record.sample_time, record.t0, record.source, record.notes, dict(record.units)]
    return [about, {name: record[name].tolist() for name in record.names}]


def answer(question: Question) -> str:
    """The answer's text, in which 22 and 22.0 are alike as to every reader of JSON, or how it is refused."""
    try:
        said = orjson.loads(orjson.dumps(question(), default=str, option=orjson.OPT_NON_STR_KEYS))
        return orjson.dumps(row_checks.plain(said)).decode()
    except (StorageUnavailable, BrokenBlock) as error:
        return f"{TELLS}: {error}"
    except Exception as error:  # an internal error is an answer too, and no other value
        return f"{TELLS}: internal error: {type(error).__name__}: {error}"


@contextmanager
def flipped(file: Path, place: int, with_: int, count: int = 1) -> Iterator[None]:
    """With so many bytes changed."""
    with open(file, "r+b") as opened:
        opened.seek(place)
        whole = opened.read(count)
        opened.seek(place)
        opened.write(bytes(each ^ with_ for each in whole))
        opened.flush()
        yield
        opened.seek(place)
        opened.write(whole)


def compared(before: dict[str, str], asked: dict[str, Question]) -> list[str]:
    """Names of the questions that are answered with another value; `told` alone where all that differ tell."""
    after = {name: answer(question) for name, question in asked.items()}
    differ = [name for name in after if after[name] != before[name]]
    return [name for name in differ if TELLS not in after[name]] or (["told"] if differ else [])


def readers(
    store: DiskStore, file: Path, before: dict[str, str], asked: dict[str, Question]
) -> list[dict[str, Question]]:
    """Of each page the questions that read it: all of its bytes are changed, so that it is no page, and they are not answered."""
    size, found = int.from_bytes(file.read_bytes()[16:18], "big"), []
    for place in range(0, file.stat().st_size, size):
        store._database.engine.dispose()
        with flipped(file, place, 0xFF, size):
            found.append(
                {
                    name: question
                    for name, question in asked.items()
                    if answer(question) != before[name]
                }
            )
    return found


def flip_pages(
    folder: Path, url: str, count: int, chance: random.Random
) -> tuple[Counter[str], Counter[str]]:
    """What so many flips in the database's file come to, and which questions are answered with another value."""
    store = DiskStore(folder, url)
    asked = questions(store)
    file = folder / "residuum.db"
    before = {name: answer(question) for name, question in asked.items()}
    size, found, where = file.stat().st_size, Counter[str](), Counter[str]()
    reads = readers(store, file, before, asked)
    for _ in range(count):
        place = chance.randrange(size)
        store._database.engine.dispose()  # what was read before is kept by a connection
        with flipped(
            file, place, chance.choice([1 << chance.randrange(8), chance.randrange(1, 256)])
        ):
            wrong = compared(before, reads[place * len(reads) // size])
            noticed = bool(wrong) and wrong != ["told"] and looked_through(store)
            store._database.engine.dispose()
        if not wrong:
            found["harmless"] += 1
        elif wrong == ["told"]:
            found["told"] += 1
        elif noticed:
            found["noticed at the start"] += 1
        else:
            found["another value"] += 1
            where.update(wrong)
    store.close()
    return found, where


def looked_through(store: DiskStore) -> bool:
    """Whether a start, or what looks at the rows beside the service that has started, notices it."""
    try:
        return (store._database.damage() or store.look_for_damage()) is not None
    except (StorageUnavailable, ValueError):
        return True


def flip_blocks(folder: Path, count: int, chance: random.Random) -> Counter[str]:
    """What so many flips in headers and samples of signal blocks come to."""
    blocks = Blocks(folder / "blocks")
    before = {path: orjson.dumps(said(blocks.read(path))) for path in blocks.paths()}
    found = Counter[str]()
    for _ in range(count):
        path = chance.choice(list(before))
        file = blocks.folder / path
        with flipped(file, chance.randrange(file.stat().st_size), chance.randrange(1, 256)):
            try:
                same = orjson.dumps(said(blocks.read(path))) == before[path]
                found["harmless" if same else "another value"] += 1
            except BrokenBlock:
                found["told"] += 1
    return found


def campaign(pages: int, blocks: int, seed: int) -> tuple[dict[str, Counter[str]], Counter[str]]:
    """What flips in pages and in blocks come to, and which questions were answered with another value."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        url = fill(folder)
        of_pages, where = flip_pages(folder, url, pages, chance)
        return {
            "database pages": of_pages,
            "signal blocks": flip_blocks(folder, blocks, chance),
        }, where


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pages", type=int, default=10_000)
    parser.add_argument("--blocks", type=int, default=90_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found, where = campaign(given.pages, given.blocks, given.seed)
    for what, each in found.items():
        print(f"{what:<16}{sum(each.values()):>7} flips: {dict(each.most_common())}")
    for question, times in where.most_common():
        print(f"another value     {question}: {times}")
    sys.exit(bool(where) or any(each["another value"] for each in found.values()))


if __name__ == "__main__":
    main()
