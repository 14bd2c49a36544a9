"""Hourly history of findings whose rows were let go."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision: str = "0004"
down_revision: str | None = "0003"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    document = sa.JSON().with_variant(postgresql.JSONB(), "postgresql")
    op.create_table(
        "finding_hours",
        sa.Column("asset_id", sa.String(length=64), nullable=False),
        sa.Column("hour", sa.DateTime(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("verdicts", document, nullable=False),
        sa.Column("indicators", document, nullable=False),
        sa.ForeignKeyConstraint(["asset_id"], ["assets.id"], name="fk_finding_hours_asset_id"),
        sa.PrimaryKeyConstraint("asset_id", "hour", name="pk_finding_hours"),
    )


def downgrade() -> None:
    """Back to the one before."""
    op.drop_table("finding_hours")
