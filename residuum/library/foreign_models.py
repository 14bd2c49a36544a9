"""Models that an engineer already has, as objects or equations of another library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from residuum.identification.errors import BadModel
from residuum.library.model import Model, model


def linear_model(
    system: Any,
    *,
    name: str = "linear model",
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> Model:
    """A transfer function or state space as a model: effects are judged on the paths of its inputs
    and outputs.

    Parameters
    ----------
    system : object of python-control or SciPy
        With `num` and `den`, or `A B C D`; a `dt` that is not zero means discrete time, its input
        held over a sample.
    name : str
    inputs, outputs : names of the signals
        As records have them; `u` and `y` by default, numbered where there are several.
    units : mapping of signal to unit

    Returns
    -------
    Model
        The coefficients of a transfer function are free parameters; the entries of a state space
        are fixed.

    Raises
    ------
    BadModel
        Not such an object, not proper, a pole in discrete time that continuous time has not.

    Examples
    --------
    >>> import residuum as rs, scipy.signal
    >>> lag = scipy.signal.TransferFunction([2.0], [0.5, 1.0])
    >>> units = {"voltage": "V", "speed": "rad/s"}
    >>> rs.linear_model(lag, inputs=["voltage"], outputs=["speed"], units=units).outputs
    {'speed': 'rad/s'}
    """
    # SciPy, for these alone
    from residuum.identification.physics.files.linear_model import (  # noqa: PLC0415
        LinearSignals,
        linear_text,
        of_object,
    )

    matrices, sample_time = of_object(system)
    # By the text of a model file, which says and refuses the same as one that a user writes.
    return model(linear_text(name, matrices, LinearSignals(inputs, outputs, units), sample_time))


def equations_model(
    rates: Mapping[Any, Any],
    outputs: Mapping[str, Any],
    *,
    states: Mapping[str, str],
    inputs: Mapping[str, str] | None = None,
    parameters: Mapping[str, tuple[float, str]] | None = None,
    kinds: Mapping[str, str] | None = None,
    name: str = "equations",
) -> Model:
    """A model of SymPy expressions for the time derivatives of states.

    Parameters
    ----------
    rates : mapping of state to expression
        Of states, inputs and parameters, by symbols of their names. A rate that is another state
        makes the one the position of the other.
    outputs : mapping of name to expression
    states, inputs : mapping of name to unit
    parameters : mapping of name to (value, unit)
    kinds : mapping of state to kind of balance
        `torque`, `force`, `voltage`, `heat`, `volume`: which effects may act on the state; `signal`
        (none) by default.
    name : str

    Returns
    -------
    Model

    Raises
    ------
    BadModel
        A function that expressions of models have not, a name that is not declared, units that do
        not fit.

    Examples
    --------
    >>> import residuum as rs, sympy
    >>> q, v, F, M, d = sympy.symbols("q v F M d", real=True)
    >>> axis = rs.equations_model(
    ...     {q: v, v: (F - d * v) / M}, {"position": q}, states={"q": "m", "v": "m/s"}, inputs={"F": "N"},
    ...     parameters={"M": (95.0, "kg"), "d": (3.0, "N*s/m")}, kinds={"v": "force"},
    ... )
    >>> axis.with_effect("coulomb-friction", "v", tau_c=0.2).effects
    ('coulomb-friction@v',)
    """
    # SymPy, for these alone
    from residuum.identification.physics.files.sympy_model import model_table  # noqa: PLC0415

    by_name = {str(state): rate for state, rate in rates.items()}
    unlike = set(by_name) ^ set(states)
    if unlike:
        raise BadModel(f"equations: state {sorted(unlike)[0]!r} needs both a rate and a unit")
    plain = model_table(
        name,
        by_name,
        outputs,
        (dict(states), dict(inputs or {}), dict(parameters or {})),
        dict(kinds or {}),
    )
    # By the text of a model file: what the file's rules refuse is refused here in the same words.
    return model(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=10_000))
