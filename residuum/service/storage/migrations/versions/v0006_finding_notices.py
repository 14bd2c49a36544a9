"""Findings that wait to be told, each for every receiver that wants findings."""

import sqlalchemy as sa
from alembic import op

revision: str = "0006"
down_revision: str | None = "0005"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column(
        "receivers", sa.Column("findings", sa.Boolean(), server_default=sa.false(), nullable=False)
    )
    op.add_column(
        "receivers",
        sa.Column("findings_lost", sa.BigInteger(), server_default=sa.text("0"), nullable=False),
    )
    op.create_table(
        "finding_notices",
        sa.Column("receiver_id", sa.String(length=64), nullable=False),
        sa.Column(
            "finding_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False
        ),
        sa.ForeignKeyConstraint(
            ["receiver_id"], ["receivers.id"], name="fk_finding_notices_receiver_id"
        ),
        sa.ForeignKeyConstraint(
            ["finding_id"], ["findings.id"], name="fk_finding_notices_finding_id"
        ),
        sa.PrimaryKeyConstraint("receiver_id", "finding_id", name="pk_finding_notices"),
    )
    op.create_index("ix_finding_notices_finding_id", "finding_notices", ["finding_id"])


def downgrade() -> None:
    """Back to the one before."""
    op.drop_table("finding_notices")
    op.drop_column("receivers", "findings_lost")
    op.drop_column("receivers", "findings")
