"""Tables of assets, windows, findings, alarms, records and models."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision: str = "0001"
down_revision: str | None = None
branch_labels: str | None = None
depends_on: str | None = None

IDENTITY = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
DOCUMENT = sa.JSON().with_variant(postgresql.JSONB(), "postgresql")


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "assets",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("diagnoser", sa.String(length=64), nullable=True),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("last_finding_id", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_assets"),
    )
    op.create_table(
        "models",
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("last_number", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_models"),
    )
    op.create_table(
        "records",
        sa.Column("id", IDENTITY, autoincrement=True, nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("t0", sa.Float(), nullable=False),
        sa.Column("sample_time", sa.Float(), nullable=False),
        sa.Column("n", sa.BigInteger(), nullable=False),
        sa.Column("units", DOCUMENT, nullable=False),
        sa.Column("notes", DOCUMENT, nullable=False),
        sa.Column("block_path", sa.String(length=200), nullable=False),
        sa.Column("block_checksum", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_records"),
        sa.UniqueConstraint("block_path", name="uq_records_block_path"),
    )
    op.create_table(
        "model_versions",
        sa.Column("model_id", sa.String(length=64), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.Column("created_by", sa.String(length=64), nullable=True),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("checksum", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(["model_id"], ["models.id"], name="fk_model_versions_model_id"),
        sa.PrimaryKeyConstraint("model_id", "number", name="pk_model_versions"),
    )
    op.create_table(
        "windows",
        sa.Column("id", IDENTITY, autoincrement=True, nullable=False),
        sa.Column("asset_id", sa.String(length=64), nullable=False),
        sa.Column("received_at", sa.DateTime(), nullable=False),
        sa.Column("t0", sa.Float(), nullable=False),
        sa.Column("sample_time", sa.Float(), nullable=False),
        sa.Column("n", sa.BigInteger(), nullable=False),
        sa.Column("units", DOCUMENT, nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("block_path", sa.String(length=200), nullable=False),
        sa.Column("block_checksum", sa.String(length=64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("idempotency_key", sa.String(length=200), nullable=True),
        sa.Column("digest", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["asset_id"], ["assets.id"], name="fk_windows_asset_id"),
        sa.PrimaryKeyConstraint("id", name="pk_windows"),
        sa.UniqueConstraint(
            "asset_id", "idempotency_key", name="uq_windows_asset_id_idempotency_key"
        ),
        sa.UniqueConstraint("block_path", name="uq_windows_block_path"),
    )
    op.create_index("ix_windows_asset_id_id", "windows", ["asset_id", "id"])

    op.create_table(
        "alarms",
        sa.Column("id", IDENTITY, autoincrement=True, nullable=False),
        sa.Column("asset_id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=20), nullable=False),
        sa.Column("state", sa.String(length=30), nullable=False),
        sa.Column("condition", sa.Boolean(), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("occurrences", sa.Integer(), nullable=False),
        sa.Column("raised_at", sa.DateTime(), nullable=True),
        sa.Column("cleared_at", sa.DateTime(), nullable=True),
        sa.Column("acknowledged_at", sa.DateTime(), nullable=True),
        sa.Column("acknowledged_by", sa.String(length=64), nullable=True),
        sa.Column("shelved_until", sa.DateTime(), nullable=True),
        sa.Column("comment", sa.Text(), nullable=True),
        sa.Column("window_id", IDENTITY, nullable=True),
        sa.ForeignKeyConstraint(["asset_id"], ["assets.id"], name="fk_alarms_asset_id"),
        sa.ForeignKeyConstraint(["window_id"], ["windows.id"], name="fk_alarms_window_id"),
        sa.PrimaryKeyConstraint("id", name="pk_alarms"),
        sa.UniqueConstraint("asset_id", "kind", name="uq_alarms_asset_id_kind"),
    )
    op.create_table(
        "findings",
        sa.Column("id", IDENTITY, autoincrement=True, nullable=False),
        sa.Column("asset_id", sa.String(length=64), nullable=False),
        sa.Column("window_id", IDENTITY, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("diagnoser", sa.String(length=64), nullable=False),
        sa.Column("verdict", sa.String(length=20), nullable=False),
        sa.Column("fault_class", sa.String(length=64), nullable=True),
        sa.Column("indicators", DOCUMENT, nullable=False),
        sa.Column("thresholds", DOCUMENT, nullable=False),
        sa.Column("units", DOCUMENT, nullable=False),
        sa.Column("evidence", DOCUMENT, nullable=False),
        sa.Column("reason", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["asset_id"], ["assets.id"], name="fk_findings_asset_id"),
        sa.ForeignKeyConstraint(["window_id"], ["windows.id"], name="fk_findings_window_id"),
        sa.PrimaryKeyConstraint("id", name="pk_findings"),
    )
    op.create_index("ix_findings_asset_id_id", "findings", ["asset_id", "id"])
    op.create_index("ix_findings_window_id", "findings", ["window_id"])

    op.create_table(
        "alarm_journal",
        sa.Column("id", IDENTITY, autoincrement=True, nullable=False),
        sa.Column("alarm_id", IDENTITY, nullable=False),
        sa.Column("at", sa.DateTime(), nullable=False),
        sa.Column("event", sa.String(length=20), nullable=False),
        sa.Column("state", sa.String(length=30), nullable=False),
        sa.Column("by", sa.String(length=64), nullable=True),
        sa.Column("comment", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(["alarm_id"], ["alarms.id"], name="fk_alarm_journal_alarm_id"),
        sa.PrimaryKeyConstraint("id", name="pk_alarm_journal"),
    )
    op.create_index("ix_alarm_journal_alarm_id", "alarm_journal", ["alarm_id"])


def downgrade() -> None:
    """Back to the one before."""
    op.drop_index("ix_alarm_journal_alarm_id", "alarm_journal")

    op.drop_table("alarm_journal")
    op.drop_index("ix_findings_window_id", "findings")
    op.drop_index("ix_findings_asset_id_id", "findings")

    op.drop_table("findings")
    op.drop_table("alarms")
    op.drop_index("ix_windows_asset_id_id", "windows")

    op.drop_table("windows")
    op.drop_table("model_versions")
    op.drop_table("records")
    op.drop_table("models")
    op.drop_table("assets")
