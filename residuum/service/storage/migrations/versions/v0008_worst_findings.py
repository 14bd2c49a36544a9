"""How bad the worst finding since an alarm was raised is, and when it was."""

import sqlalchemy as sa
from alembic import op

revision: str = "0008"
down_revision: str | None = "0007"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("alarms", sa.Column("worst", sa.Float(), nullable=True))
    op.add_column("alarms", sa.Column("worst_at", sa.DateTime(), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    op.drop_column("alarms", "worst_at")
    op.drop_column("alarms", "worst")
