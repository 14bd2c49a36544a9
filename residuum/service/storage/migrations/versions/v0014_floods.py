"""Floods of alarms, which receivers are told as one."""

import sqlalchemy as sa
from alembic import op

revision: str = "0014"
down_revision: str | None = "0013"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "alarm_floods",
        sa.Column(
            "id",
            sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
            autoincrement=True,
            nullable=False,
        ),
        sa.Column("began_at", sa.DateTime(), nullable=False),
        sa.Column("ended_at", sa.DateTime(), nullable=True),
        sa.Column("more_than", sa.Integer(), nullable=False),
        sa.Column("raised", sa.Integer(), nullable=False),
        sa.Column("checksum", sa.String(length=8), nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_alarm_floods"),
    )
    op.create_index("ix_alarm_floods_ended_at", "alarm_floods", ["ended_at"])


def downgrade() -> None:
    """Back to the one before."""
    op.drop_table("alarm_floods")
