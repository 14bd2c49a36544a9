"""For how long an alarm's opposite was seen, when its machine was last judged, and which indicators
raised it.
"""

import sqlalchemy as sa
from alembic import op

revision: str = "0009"
down_revision: str | None = "0008"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("alarms", sa.Column("pending_seconds", sa.Float(), nullable=True))
    op.add_column("alarms", sa.Column("judged_at", sa.DateTime(), nullable=True))
    op.add_column("alarms", sa.Column("judged_every", sa.Float(), nullable=True))
    op.add_column("alarms", sa.Column("raised_by", sa.Text(), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    for column in ("raised_by", "judged_every", "judged_at", "pending_seconds"):
        op.drop_column("alarms", column)
