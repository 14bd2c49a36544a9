"""What a refusal of a name says: the nearest of the names that there are, and all of them."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

# Share of letters that a name has in common with what was written, from which it may have been
# meant (difflib's own).
_LIKE = 0.6


def nearest_names(
    written: object, known: Iterable[object], most: int = 1, like: float = _LIKE
) -> list[str]:
    """The `most` names that are written nearly as `written` is, the nearest first; capitals, `_`
    and `-` count as alike.

    >>> nearest_names("Coulom_friction", ["viscous-friction", "coulomb-friction"])
    ['coulomb-friction']
    """
    by_spelling = {_spelling(name): str(name) for name in known}
    return [
        by_spelling[name]
        for name in get_close_matches(_spelling(written), list(by_spelling), n=most, cutoff=like)
    ]


def did_you_mean(written: object, known: Iterable[object]) -> str:
    """The question after the nearest name, with a space behind it; empty where no name is near.

    >>> did_you_mean("gate-driv", ["oven", "gate-drive"])
    "did you mean 'gate-drive'? "
    """
    return "".join(f"did you mean {name!r}? " for name in nearest_names(written, known))


def known_names(written: object, known: Iterable[object], says: str = "known are") -> str:
    """The end of every refusal of a name: the nearest one as a question, then all that there are.

    >>> known_names("bearin", ["bearing", "model-based"])
    "did you mean 'bearing'? known are bearing, model-based"
    >>> known_names("a", [], "there are")
    'there are none'
    """
    names = [str(name) for name in known]
    return f"{did_you_mean(written, names)}{says} {', '.join(names) or 'none'}"


def _spelling(name: object) -> str:
    return str(name).casefold().replace("_", "-").replace(" ", "-")
