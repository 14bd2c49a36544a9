"""`residuum scorer`: judges windows that gateways send over MQTT."""

from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.settings_template import DatabaseUrl
from residuum.service.commands.until_interrupted import until_interrupted
from residuum.service.logs import set_up_logs
from residuum.service.notifications import Notifications
from residuum.service.settings import load_settings
from residuum.service.storage import DiskStore
from residuum.service.window_queue.scorer import Scorer
from residuum.service.work.worker_pool import WorkerPool

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def scorer(
    part: Annotated[
        str,
        typer.Option(
            metavar="K/N",
            help=(
                "Number of this scorer and of all scorers, as 1/3. Each scorer has its share of the"
                " machines."
            ),
        ),
    ] = "1/1",
    database: DatabaseUrl = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of signal blocks, shared with the service.")
    ] = None,
) -> None:
    """Take windows from the broker that the settings name, judge them, and store each once. Runs
    until interrupted.
    """
    settings = load_settings(database=database, data=data)
    if not settings.mqtt:
        raise BadInput(
            "setting mqtt: is empty; a scorer needs the broker that its windows come from"
        )
    number, _, many = part.partition("/")
    if not (number.isdecimal() and many.isdecimal()):
        raise BadInput(f"--part {part!r}: must be K/N, for example 1/2")
    set_up_logs(settings)
    notifications = Notifications(settings)
    store = DiskStore(settings.data, settings.database_url, notifications.tell, settings.alarm_rule)
    # Before the first window: what an earlier scorer left untold is told now.
    notifications.start(store.outbox, store.note_order)
    # One worker: a machine's windows are judged in their order, and more scorers take more
    # machines.
    pool = WorkerPool(1)
    try:
        consumer = Scorer(
            settings.broker,
            int(number),
            int(many),
            pool,
            store,
            settings.data,
            fmus=settings.allow_fmus,
        )
        consumer.start()
        until_interrupted(f"Scorer {part} takes windows.")
        consumer.stop()
    finally:
        # In the order in which they use each other: nobody may write to a store that is closed.
        pool.terminate()
        notifications.stop()
        store.close()
