"""Runs migrations on the connection that `Database.migrate` hands over (Alembic loads this
file).
"""

from alembic import context

from residuum.service.storage.tables import metadata


def migrate() -> None:
    """Run the migrations that Alembic has chosen."""
    context.configure(
        connection=context.config.attributes["connection"],
        target_metadata=metadata,
        render_as_batch=True,
    )
    context.run_migrations()


if hasattr(context, "config"):  # absent when the file is imported and not run by Alembic
    migrate()
