"""Effects join a model, one after the other or together, where the error on data kept aside does not rise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np

from residuum.identification.discrepancy.exact_structure import Exact
from residuum.identification.discrepancy.fitting.structure_fits import fit_structure, in_likelier_order
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.improvement import Step
from residuum.identification.discrepancy.improving.begin_improving import Beginning
from residuum.identification.discrepancy.improving.held_out_error import HeldOutError
from residuum.identification.discrepancy.policy.acceptance import KEPT_RISE, KEPT_SHIFT, MOST_TOGETHER
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Experiment, Key
from residuum.identification.work import Tell


def all_joined(begun: Beginning, judge: HeldOutError, history: list[Step], tell: Tell) -> tuple[Structure, bool]:
    """The base with the chosen effects that do not raise the held-out error, and whether one was refused (shifts apart)."""
    exact, experiments, chosen = begun.exact, begun.experiments, begun.chosen
    kept, waiting, tried = begun.base, chosen, len(chosen) + 1
    before = list(history)
    while len(waiting) < tried:  # what does not help alone may help beside what joined after it
        tried = len(waiting)
        kept, waiting = _joined(kept, waiting, experiments, judge, history, exact, tell)
    shifts = [] if exact is None else exact.found.timing
    refused = any(key not in shifts for key in waiting)
    if exact is not None and refused and len(chosen) > 1:
        together, steps = _joined_together(begun.base, chosen, experiments, judge, history[-1].error, exact.found)
        if together is not None:
            history[:] = [*before, *steps]
            return together, False
    return kept, refused


def added(
    structure: Structure, experiments: Sequence[Experiment], key: Key, seen: Mapping[str, float] | None = None
) -> Structure | None:
    """The structure with one more effect, re-estimated; None when it diverges.

    The likelihood of a contact or of friction has many tops: every start of the effect that promises something is followed, and
    the values `seen` (by full name) where it was estimated before; the likeliest end is kept.
    """
    starts = [screened.start for screened in Screen(structure, experiments).promising(*key)]
    if seen:
        model = structure.model.with_effect(*key)
        starts.append(model.with_values({n: v for n, v in seen.items() if n in model.free}))
    fitted = [fit_structure(start, experiments, structure.initial) for start in starts]
    best = max((found for found in fitted if found is not None), key=lambda found: found.log_likelihood, default=None)
    return best if best is None else in_likelier_order(best, key, experiments)


def _joined(
    kept: Structure,
    chosen: Sequence[Key],
    experiments: Sequence[Experiment],
    judge: HeldOutError,
    history: list[Step],
    exact: Exact | None,
    tell: Tell,
) -> tuple[Structure, list[Key]]:
    """The structure with those effects that do not raise the held-out error, each told in the history; and those that did.

    In the place of one that does, those are tried that the training data cannot tell from it: data kept aside may.
    """
    refused = []
    for index, key in enumerate(chosen):
        tell(0.6 + 0.2 * index / len(chosen), f"adding {key[0]} to {key[1]}")
        if exact is None:
            better = added(kept, experiments, key)
            if better is None:
                raise NotIdentifiable(
                    f"effect {key[0]!r} at {key[1]!r}: the model diverges with it; start from other values, or leave it out"
                )
            kept = better
            history.append(judge.step(key[0], better))
            continue
        found = exact.found
        highest = history[-1].error * (KEPT_SHIFT if key in found.timing else KEPT_RISE)
        for each in found.alike(key):
            better = added(kept, experiments, each, found.values_of(each))
            error = judge.error(better) if better is not None else np.inf
            if better is not None and error <= highest:
                kept = better
                history.append(judge.step(each[0], better, error))
                break
        else:
            refused.append(key)
    return kept, refused


def _joined_together(
    base: Structure,
    chosen: Sequence[Key],
    experiments: Sequence[Experiment],
    judge: HeldOutError,
    error: float,
    found: Search,
) -> tuple[Structure | None, list[Step]]:
    """The base with all the effects at once, of which some raise the held-out `error` alone, if they do not together; and how.

    A drag without the rolling friction beside it is a better model of a van under way, and a worse one of a van that coasts.
    Where the training data cannot tell an effect from others, those kept aside may.
    """
    for keys in islice(product(*(found.alike(key) for key in chosen)), MOST_TOGETHER):
        all_: Structure | None = base
        for key in keys:
            all_ = None if all_ is None else added(all_, experiments, key, found.values_of(key))
        left = np.inf if all_ is None else judge.error(all_)
        if all_ is not None and left <= error * KEPT_RISE:
            step = replace(judge.step(None, all_, left), together=True)
            return all_, [replace(step, added=id) for id, _ in keys]
    return None, []
