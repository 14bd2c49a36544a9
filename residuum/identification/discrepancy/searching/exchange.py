"""Effects that were accepted one by one give way to others that do more together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from residuum.identification.discrepancy.fitting.structure_comparison import schwarz, within_a_sample
from residuum.identification.discrepancy.fitting.structure_fits import refit
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.acceptance import ACCEPT_MORE, EXCHANGES
from residuum.identification.discrepancy.screening.pair_screen import promising_pairs
from residuum.identification.discrepancy.searching.evidence import tempered_gain
from residuum.identification.discrepancy.searching.growth import grow, winner, without
from residuum.identification.discrepancy.searching.holding_up import holds_up
from residuum.identification.discrepancy.searching.looks import Task
from residuum.identification.discrepancy.searching.search_state import Search, evidence_asked
from residuum.identification.discrepancy.searching.trials import followed, polished
from residuum.identification.physics import Experiment, Key


def settle(found: Search, task: Task) -> None:
    """Exchange what was accepted one by one for what does more together, until nothing changes."""
    exchange_all(found, task, [] if _two_instead(found, task) else found.accepted[-1:])


def exchange_all(found: Search, task: Task, settled: list[Key]) -> None:
    """Judge all that was accepted but what is `settled` again, and add what is wanted then, until nothing changes."""
    for _ in range(EXCHANGES):
        if not _exchange(found, task, settled):
            break
        grow(found, task)
        settled = found.accepted[-1:]


def _exchange(found: Search, task: Task, settled: list[Key]) -> bool:
    """Judge each of several effects again on top of the others: kept, exchanged for a better one, or dropped as needless.

    The first that a greedy search accepts may only stand for two that are missing together (viscous friction for drag and rolling
    friction), which later steps bring to light; or it was started where it made up for them (a spring at rest elsewhere), and
    does better from another start now. Those `settled` were judged on top of the others already.

    True when an effect was exchanged, dropped or put elsewhere.
    """
    exchanges = 0
    while exchanges < EXCHANGES and (waiting := [key for key in found.accepted if key not in settled]):
        key, at = waiting[0], found.accepted.index(waiting[0])
        others = without(found.best, key, task.experiments)
        if others is None:
            settled.append(key)
            continue
        look = task.look(others, key)
        look.add({key: followed(look.screen, key, found.best)}, (), [key])
        refitted = {k: s for k, s in look.refitted.items() if k == key or not within_a_sample(s, k, task.experiments)}
        best, wins = winner(refitted, others, evidence_asked(found, ACCEPT_MORE))
        if best == key and wins:
            moved = _moved(refitted[key], found.best)
            settled, exchanges = [key] if moved else [*settled, key], exchanges + moved
            found.best, found.before[at], found.alternatives[at] = refitted[key], others, refitted
            continue
        exchanges += 1
        found.best, settled = others, []
        for steps in (found.accepted, found.before, found.alternatives):
            del steps[at]
        if best is not None and wins:
            found.best = refitted[best] = polished(refitted[best], task.experiments)
            found.before.insert(len(found.accepted), others)
            found.alternatives.insert(len(found.accepted), refitted)
            found.accepted.append(best)
            settled = [best]
    return exchanges > 0


def _moved(structure: Structure, before: Structure) -> bool:
    """Whether what effects hold fixed was put elsewhere."""
    known = before.model.all_parameters
    return any(known[n].fixed and value != known[n].value for n, value in structure.model.values.items() if n in known)


def _two_instead(found: Search, task: Task) -> bool:
    """Put two effects in place of those accepted where they do more together; whether that was so."""
    if not found.accepted:
        return False
    base = found.base
    pairs = promising_pairs(base, found.best, found.accepted, found.screened)
    fitted = [refit(found.best, m, task.experiments) for m in pairs]
    asked = evidence_asked(found, ACCEPT_MORE) if len(found.accepted) == 1 else 0.0
    better = [s for s in fitted if s is not None and tempered_gain(s, found.best) - s.penalty(found.best) > asked]
    if not better:
        return False
    pair = polished(max(better, key=lambda s: schwarz(s, base)), task.experiments)
    other = with_two(found, pair, task.experiments)
    if other is None:
        return False
    found.accepted, found.best, found.before, found.alternatives = other.accepted, other.best, other.before, other.alternatives
    return True


def with_two(found: Search, pair: Structure, experiments: Sequence[Experiment]) -> Search | None:
    """The search with the last two effects of a structure accepted in place of what it had; None where they do not hold up."""
    first, second = (use.key for use in pair.model.effects[-2:])
    if not holds_up(found, second, pair, experiments):
        return None
    accepted, alternatives = [first, second], [{first: pair}, {second: pair}]
    return replace(found, accepted=accepted, best=pair, before=[found.base, found.base], alternatives=alternatives)
