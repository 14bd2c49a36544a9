"""A checksum in each row of windows and findings."""

import sqlalchemy as sa
from alembic import op

revision: str = "0010"
down_revision: str | None = "0009"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("windows", sa.Column("checksum", sa.String(8), nullable=True))
    op.add_column("findings", sa.Column("checksum", sa.String(16), nullable=True))


def downgrade() -> None:
    """Back to the one before."""
    op.drop_column("findings", "checksum")
    op.drop_column("windows", "checksum")
