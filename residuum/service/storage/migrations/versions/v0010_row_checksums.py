"""A checksum in each row that is answered with."""

import sqlalchemy as sa
from alembic import op

revision: str = "0010"
down_revision: str | None = "0009"
branch_labels: str | None = None
depends_on: str | None = None

_COLUMNS = (
    ("windows", "checksum", 8),
    ("findings", "checksum", 24),
    ("assets", "checksum", 8),
    ("finding_hours", "checksum", 8),
    ("alarms", "checksum", 8),
    ("alarm_journal", "checksum", 8),
    ("records", "checksum", 8),
    ("models", "checksum", 8),
    ("model_versions", "row_checksum", 8),
)


def upgrade() -> None:
    """To this revision."""
    for table, column, length in _COLUMNS:
        op.add_column(table, sa.Column(column, sa.String(length), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    for table, column, _ in reversed(_COLUMNS):
        op.drop_column(table, column)
