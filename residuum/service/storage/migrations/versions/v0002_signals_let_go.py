"""When the signal of a window was let go."""

import sqlalchemy as sa
from alembic import op

revision: str = "0002"
down_revision: str | None = "0001"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """To this revision."""
    op.add_column("windows", sa.Column("signal_let_go_at", sa.DateTime(), nullable=True))
    op.create_index("ix_windows_signal_let_go_at_id", "windows", ["signal_let_go_at", "id"])


def downgrade() -> None:
    """Back to the one before."""
    op.drop_index("ix_windows_signal_let_go_at_id", "windows")
    op.drop_column("windows", "signal_let_go_at")
