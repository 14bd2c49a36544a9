"""What a model is: names, units, parameters, effects, its file; and copies of it that differ."""

from __future__ import annotations

from html import escape
from os import PathLike
from pathlib import Path
from typing import Self

from residuum.identification.physics import Key, PhysicalModel, candidates, write_model
from residuum.identification.physics.effects.base import Parameter
from residuum.library.result import html_table
from residuum.library.whole_file import write_whole


class DescribedModel:
    """A machine as a set of balances; `physical` is the model as the identification room knows
    it.
    """

    def __init__(self, physical: PhysicalModel, given: str | None = None) -> None:
        self.physical = physical
        self._given = physical.name if given is None else given

    @property
    def name(self) -> str:
        """Its name."""
        return self.physical.name

    @property
    def inputs(self) -> dict[str, str]:
        """Name → unit of each input."""
        return {name: signal.unit for name, signal in self.physical.inputs.items()}

    @property
    def outputs(self) -> dict[str, str]:
        """Name → unit of each output."""
        return {name: signal.unit for name, signal in self.physical.outputs.items()}

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter (value, unit, bounds, `fixed`, meaning) by its full name; an effect's is
        `effect@place.name`.
        """
        return self.physical.all_parameters

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects in it, as `effect@place`."""
        return tuple(use.label for use in self.physical.effects)

    @property
    def fitting_effects(self) -> list[Key]:
        """What of the catalogue fits it: each `effect` with its `target`."""
        return candidates(self.physical)

    @property
    def text(self) -> str:
        """The model file's YAML text."""
        return write_model(self.physical)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model file: whole, or not at all when interrupted.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        BadInput
            The folder does not exist.

        Examples
        --------
        >>> import residuum as rs
        >>> import pathlib, tempfile
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "axis.yaml"
        >>> rs.model("linear-axis").save(file)
        >>> rs.model(file).name
        'linear-axis'
        """
        write_whole(Path(path), self.text)

    def with_values(self, **values: float) -> Self:
        """The model with other parameter values; an effect's full names go as
        `**{"effect@place.name": value}`.

        Parameters
        ----------
        values : float
            By parameter name, in the parameter's unit.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            An unknown name, or a value out of its bounds.

        Examples
        --------
        >>> import residuum as rs
        >>> rs.model("linear-axis").with_values(M=90.0).parameters["M"].value
        90.0
        """
        return type(self)(self.physical.with_values(values))

    def with_effect(self, effect: str, place: str, **values: float) -> Self:
        """The model with one more effect at a balance, input or output.

        Parameters
        ----------
        effect : str
            Its id in the catalogue.
        place : str
            Name of the balance, input or output.
        values : float
            By the effect's own parameter names.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            An effect that is not in the catalogue or does not fit there; a value out of its bounds.

        Examples
        --------
        >>> import residuum as rs
        >>> axis = rs.model("linear-axis").with_effect("coulomb-friction", "axis", tau_c=20.0)
        >>> axis.effects
        ('coulomb-friction@axis',)
        """
        return type(self)(self.physical.with_effect(effect, place, values))

    def without_effect(self, label: str) -> Self:
        """The model without one of its effects.

        Parameters
        ----------
        label : str
            `effect@place`, or `effect` where it occurs once.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            No such effect in the model.

        Examples
        --------
        >>> import residuum as rs
        >>> axis = rs.model("linear-axis").with_effect("coulomb-friction", "axis", tau_c=20.0)
        >>> axis.without_effect("coulomb-friction").effects
        ()
        """
        return type(self)(self.physical.without_effect(label))

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        with_ = f", with {', '.join(self.effects)}" if self.effects else ""
        return (
            f"<residuum Model {self.name!r}: {', '.join(self.inputs) or 'no input'} →"
            f" {', '.join(self.outputs)}{with_}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            {
                "parameter": name,
                "value": p.value,
                "unit": p.unit,
                "fixed": p.fixed,
                "meaning": p.meaning,
            }
            for name, p in self.parameters.items()
        ]
        return f"<div><strong>{escape(self.name)}</strong>{html_table(rows)}</div>"
