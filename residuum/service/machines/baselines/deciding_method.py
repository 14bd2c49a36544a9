"""Which of a diagnoser's methods decides for a machine: chosen while the service runs, and kept."""

from __future__ import annotations

import orjson

from residuum.identification.errors import BadInput
from residuum.nearest_names import did_you_mean
from residuum.service.machines.adding.kept_machines import KIND, document_name, kept_document
from residuum.service.machines.judging.judges import diagnoser_class
from residuum.service.store import Store


def _name(asset: str) -> str:
    return f"{asset}.method"


def deciding_method(store: Store, asset: str, diagnoser: str, otherwise: str | None = None) -> str | None:
    """Which of a diagnoser's methods decides for a machine: the one that somebody chose while the service ran, else `otherwise`.

    The store is asked only for a diagnoser that has a choice. NotFound for a diagnoser that there is not.
    """
    methods = diagnoser_class(diagnoser).methods
    if len(methods) < 2:
        return otherwise
    chosen = chosen_method(store, asset)
    return chosen if chosen in methods else otherwise


def chosen_method(store: Store, asset: str) -> str | None:
    """`source` or `default` as somebody chose for this machine; None: as its baseline was trained, or its settings say.

    For a machine whose name is too long for a document nothing can have been chosen.
    """
    document = kept_document(store, _name(asset))
    return None if document is None or document["method"] is None else str(document["method"])


def choose_method(store: Store, asset: str, method: str | None, by: str) -> None:
    """Let a method decide from the machine's next window on; None takes the choice back.

    Raises
    ------
    NotFound
        No such machine.
    BadInput
        Its diagnoser has no such method, or the machine has no diagnoser yet.
    Conflict
        The machine's name is too long for a document beside it.
    """
    diagnoser = store.asset(asset).diagnoser
    if diagnoser is None:
        raise BadInput(f"asset {asset!r}: has no diagnoser yet, so no method can decide")
    known = diagnoser_class(diagnoser).methods
    if method is not None and method not in known:
        raise BadInput(f"diagnoser {diagnoser!r}, method {method!r}: {did_you_mean(method, known)}must be {' or '.join(known)}")
    document_name(asset)  # refuses a name that is too long
    store.add_model_version(_name(asset), KIND, orjson.dumps({"method": method}), "method", by)
