"""The tables: rows point to signal blocks, times are UTC."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
    false,
    text,
)
from sqlalchemy.dialects.postgresql import JSONB


class UtcDateTime(TypeDecorator[datetime]):
    """A moment, stored as UTC without zone, so that both databases keep microseconds and order
    alike.
    """

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Aware datetime to naive UTC."""
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: Any, dialect: Dialect) -> datetime | None:
        """Naive UTC to aware datetime."""
        return None if value is None else value.replace(tzinfo=UTC)


# SQLite numbers rows by itself only where a key's type is INTEGER to the letter.
Identity = BigInteger().with_variant(Integer, "sqlite")
Document = JSON().with_variant(JSONB, "postgresql")

# Constraints have names, so that a migration can drop them by name on either database.
metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    }
)

assets = Table(
    "assets",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("title", String(200), nullable=False),
    Column("diagnoser", String(64)),
    Column("created_at", UtcDateTime, nullable=False),
    Column("windows", BigInteger, nullable=False, default=0),
    # No foreign key: findings point to assets, and two tables that point to each other could be
    # neither restored nor deleted in an order.
    Column("last_finding_id", BigInteger),
    Column("checksum", String(8)),
)

windows = Table(
    "windows",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("asset_id", ForeignKey("assets.id"), nullable=False),
    Column("received_at", UtcDateTime, nullable=False),
    Column("t0", Float, nullable=False),
    Column("sample_time", Float, nullable=False),
    Column("n", BigInteger, nullable=False),
    Column("units", Document, nullable=False),
    Column("source", Text, nullable=False),
    Column("block_path", String(200), nullable=False, unique=True),
    Column("block_checksum", String(64), nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("idempotency_key", String(200)),
    Column("digest", String(64)),
    Column("signal_let_go_at", UtcDateTime),
    Column("checksum", String(8)),
    # Of two requests with one key at the same moment the database itself refuses the second one.
    UniqueConstraint("asset_id", "idempotency_key"),
    Index(None, "asset_id", "id"),
    # Retention asks for the oldest whose signal is still kept.
    Index(None, "signal_let_go_at", "id"),
)

findings = Table(
    "findings",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("asset_id", ForeignKey("assets.id"), nullable=False),
    Column("window_id", ForeignKey("windows.id"), nullable=False, index=True),
    Column("at", UtcDateTime, nullable=False),
    Column("diagnoser", String(64), nullable=False),
    Column("verdict", String(20), nullable=False),
    Column("fault_class", String(64)),
    Column("indicators", Document, nullable=False),
    Column("thresholds", Document, nullable=False),
    Column("units", Document, nullable=False),
    Column("evidence", Document, nullable=False),
    Column("reason", Text),
    Column("checksum", String(24)),
    Index(None, "asset_id", "id"),
)

confirmations = Table(
    "confirmations",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("asset_id", ForeignKey("assets.id"), nullable=False),
    # No keys of other tables: what was found at a machine outlives the rows of what was said.
    Column("finding_id", BigInteger, nullable=False),
    Column("window_id", BigInteger, nullable=False),
    Column("finding_at", UtcDateTime, nullable=False),
    Column("diagnoser", String(64), nullable=False),
    Column("verdict", String(20), nullable=False),
    Column("said", Text, nullable=False),
    Column("probability", Float),
    Column("outcome", String(12), nullable=False),
    Column("cause", Text),
    Column("part", Text),
    Column("order_number", Text),
    Column("who", Text, nullable=False),
    Column("found_at", UtcDateTime, nullable=False),
    Column("note", Text),
    Column("healthy", Boolean, nullable=False),
    Column("at", UtcDateTime, nullable=False),
    Column("by", String(64)),
    Column("checksum", String(8)),
    Index(None, "finding_id"),
    Index(None, "asset_id", "finding_at"),
)

finding_hours = Table(
    "finding_hours",
    metadata,
    Column("asset_id", ForeignKey("assets.id"), primary_key=True),
    Column("hour", UtcDateTime, primary_key=True),
    Column("windows", BigInteger, nullable=False),
    Column("verdicts", Document, nullable=False),
    Column("indicators", Document, nullable=False),
    Column("checksum", String(8)),
)

alarms = Table(
    "alarms",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("asset_id", ForeignKey("assets.id"), nullable=False),
    Column("kind", String(20), nullable=False),
    Column("state", String(30), nullable=False),
    Column("condition", Boolean, nullable=False),
    Column("message", Text, nullable=False),
    Column("occurrences", Integer, nullable=False),
    Column("worst", Float),
    Column("worst_at", UtcDateTime),
    Column("raised_at", UtcDateTime),
    Column("cleared_at", UtcDateTime),
    Column("pending_since", UtcDateTime),
    Column("pending_seconds", Float),
    Column("judged_at", UtcDateTime),
    Column("judged_every", Float),
    Column("raised_by", Text),
    Column("acknowledged_at", UtcDateTime),
    Column("acknowledged_by", String(64)),
    Column("shelved_until", UtcDateTime),
    Column("comment", Text),
    Column("window_id", ForeignKey("windows.id")),
    Column("priority", String(10)),
    Column("suppressed_by", Text),
    Column("checksum", String(8)),
    UniqueConstraint("asset_id", "kind"),
)

alarm_journal = Table(
    "alarm_journal",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("alarm_id", ForeignKey("alarms.id"), nullable=False, index=True),
    Column("at", UtcDateTime, nullable=False),
    Column("event", String(20), nullable=False),
    Column("state", String(30), nullable=False),
    Column("by", String(64)),
    Column("comment", Text),
    Column("checksum", String(8)),
    Index(None, "at"),
)

audit = Table(
    "audit",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("at", UtcDateTime, nullable=False),
    Column("by", String(64)),
    Column("action", String(40), nullable=False),
    Column("subject", String(120), nullable=False),
    Column("detail", Text, nullable=False),
    Column("digest", String(64), nullable=False),
)

audit_head = Table(
    "audit_head",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("entries", BigInteger, nullable=False),
    Column("digest", String(64), nullable=False),
)

# Numbered by us, as the trail is: a sequence of the database leaves gaps where a transaction is
# rolled back, and a gap here means that a notice was let go untold.
alarm_notices = Table(
    "alarm_notices",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=False),
    Column("alarm", Document, nullable=False),
    Column("checksum", String(8)),
)

alarm_floods = Table(
    "alarm_floods",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("began_at", UtcDateTime, nullable=False),
    Column("ended_at", UtcDateTime),
    Column("more_than", Integer, nullable=False),
    Column("raised", Integer, nullable=False),
    Column("checksum", String(8)),
    Index(None, "ended_at"),
)

receivers = Table(
    "receivers",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("told", BigInteger, nullable=False),
    Column("holder", String(64)),
    Column("held_until", UtcDateTime),
    Column("findings", Boolean, nullable=False, server_default=false()),
    Column("findings_lost", BigInteger, nullable=False, server_default=text("0")),
)

finding_notices = Table(
    "finding_notices",
    metadata,
    Column("receiver_id", ForeignKey("receivers.id"), primary_key=True),
    Column("finding_id", ForeignKey("findings.id"), primary_key=True, index=True),
)

identity = Table(
    "identity",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("folder", String(64), nullable=False),
)

records = Table(
    "records",
    metadata,
    Column("id", Identity, primary_key=True, autoincrement=True),
    Column("name", String(200), nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("t0", Float, nullable=False),
    Column("sample_time", Float, nullable=False),
    Column("n", BigInteger, nullable=False),
    Column("units", Document, nullable=False),
    Column("notes", Document, nullable=False),
    Column("block_path", String(200), nullable=False, unique=True),
    Column("block_checksum", String(64), nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("checksum", String(8)),
)

models = Table(
    "models",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("kind", String(20), nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("last_number", Integer, nullable=False),
    Column("checksum", String(8)),
)

model_versions = Table(
    "model_versions",
    metadata,
    Column("model_id", ForeignKey("models.id"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("created_at", UtcDateTime, nullable=False),
    Column("created_by", String(64)),
    Column("note", Text, nullable=False),
    Column("content", LargeBinary, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("checksum", String(64), nullable=False),
    Column("row_checksum", String(8)),
)
