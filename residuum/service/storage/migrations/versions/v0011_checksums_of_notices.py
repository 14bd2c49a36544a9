"""A checksum in each notice of an alarm that receivers are still to be told."""

import sqlalchemy as sa
from alembic import op

revision: str = "0011"
down_revision: str | None = "0010"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("alarm_notices", sa.Column("checksum", sa.String(8), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    op.drop_column("alarm_notices", "checksum")
