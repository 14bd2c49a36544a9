"""Priority of an alarm, and the state of its machine that suppresses it."""

import sqlalchemy as sa
from alembic import op

revision: str = "0013"
down_revision: str | None = "0012"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("alarms", sa.Column("priority", sa.String(length=10), nullable=True))
    op.add_column("alarms", sa.Column("suppressed_by", sa.Text(), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    for column in ("suppressed_by", "priority"):
        op.drop_column("alarms", column)
