"""`rs.effects`: the catalogue of physical effects, and how to add one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.files.effect_file import read_effects
from residuum.identification.physics.model import find_effect
from residuum.library.answers.effect import effect_json, effect_line
from residuum.library.result import data_frame, html_table

if TYPE_CHECKING:
    import pandas


class Catalogue(Mapping[str, Effect]):
    """Physical effects by id. Iterating gives ids; `rs.effects["radiation"]` is an effect with its
    equation and parameters.

    Examples
    --------
    >>> import residuum as rs
    >>> rs.effects["quadratic-drag"].equation, "backlash" in rs.effects
    ('−c·v·|v|', True)
    """

    def __getitem__(self, id: str) -> Effect:
        return find_effect(id)

    def __iter__(self) -> Iterator[str]:
        return iter(EFFECTS)

    def __len__(self) -> int:
        return len(EFFECTS)

    def __contains__(self, id: object) -> bool:
        return id in EFFECTS

    def add(self, effect: Effect | type[Effect]) -> None:
        """Add an effect of your own; from then on it is everywhere where the catalogue is, in this
        process.

        Parameters
        ----------
        effect : Effect, or its class
            With `id`, `title`, `equation`, `reference`, `acts_on`, `parameters`, `contribution`,
            `starts` and `examples`, as those in `residuum/identification/physics/effects` have
            them.

        Raises
        ------
        BadModel
            An id that is taken or is not of small letters, digits and `-`; a class attribute that
            is missing.

        Examples
        --------
        See "Add an effect" in the documentation.

        >>> import residuum as rs
        >>> rs.effects.add(rs.effects["radiation"])  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        residuum.identification.errors.BadModel: ...
        """
        EFFECTS.add(effect() if isinstance(effect, type) else effect)

    def read(self, path: str | PathLike[str]) -> list[str]:
        """Add the effects that the YAML file `path` defines; returns their ids.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        list of str

        Raises
        ------
        BadModel
            No such file, or anything wrong in it, with line and column; an id of the catalogue.

        Examples
        --------
        See "Add an effect" in the documentation.

        >>> import residuum as rs
        >>> rs.effects.read("none.yaml")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        residuum.identification.errors.BadModel: ...
        """
        added = read_effects(Path(path))
        # Read whole before anything is added: a file with a fault adds nothing.
        for effect in added:
            EFFECTS.add(effect)
        return [effect.id for effect in added]

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of `residuum effects --json`.

        Returns
        -------
        dict

        Examples
        --------
        >>> import residuum as rs
        >>> sorted(rs.effects.to_dict())
        ['effects']
        """
        return {"effects": [effect_json(effect) for effect in EFFECTS.values()]}

    def to_pandas(self) -> pandas.DataFrame:
        """A row an effect; MissingPackage when pandas is not installed.

        Returns
        -------
        pandas.DataFrame

        Examples
        --------
        >>> import residuum as rs
        >>> len(rs.effects.to_pandas()) == len(rs.effects)
        True
        """
        return data_frame(self.to_dict()["effects"])

    def __str__(self) -> str:
        return "\n".join(map(effect_line, self.to_dict()["effects"]))

    def __repr__(self) -> str:
        return f"<residuum effects: {len(self)}, from {next(iter(self))} on>"

    def _repr_html_(self) -> str:
        return html_table(self.to_dict()["effects"])


effects = Catalogue()
"""The one catalogue."""
