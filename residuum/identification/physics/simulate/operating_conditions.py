"""Operating conditions of a place in a model: the scales an effect's first values are chosen by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.model import Balance, PhysicalModel, place_of, tied_to
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.simulation import Simulator

Array = npt.NDArray[np.float64]


def conditions_at(
    model: PhysicalModel,
    effect: Effect,
    target: str,
    experiment: Experiment,
    X: Array,
    missing: Array | None = None,
) -> Conditions:
    """Scales of the balance, input or output that an effect acts on, along the states X (simulated
    or smoothed) of an experiment.

    `missing` is the balance's smoothed missing term along the same samples, when there is one.
    """
    simulator = Simulator(model)
    duration = experiment.n * experiment.sample_time
    if effect.place == "balance":
        balance = model.balances[place_of(target)]
        variables = balance_variables(simulator, balance, experiment, X)
        terms = [variables[name] for name in variables if name.startswith("term:")]
        driving = variables.get("supply_terms", np.zeros(1))
        # Without an input the largest of the known terms drives; 1 where nothing moves at all.
        rms = _rms(driving) or max(map(_rms, terms), default=0.0) or 1.0
        storage = (
            float(np.median(np.abs(simulator.look(experiment, X)[f"storage:{balance.name}"])))
            or 1.0
        )
        # Last: what an effect is tied to stands behind the balance's own variables.
        variables |= _tied(simulator, effect, target, experiment, X)
        return Conditions(experiment.sample_time, duration, rms, storage, variables, missing)
    if effect.place == "input":
        signal = experiment.U[:, list(model.inputs).index(target)]
        return Conditions(
            experiment.sample_time, duration, _rms(signal) or 1.0, variables={"signal": signal}
        )
    column = list(model.outputs).index(target)
    run = simulator.look_outputs(experiment, X)[:, column]
    measured = experiment.Y[:, column]
    return Conditions(
        experiment.sample_time,
        duration,
        _rms(run) or 1.0,
        variables={"signal": run, "measured": measured},
    )


def _tied(
    simulator: Simulator, effect: Effect, target: str, experiment: Experiment, X: Array
) -> dict[str, Array]:
    """What an effect is tied to: signals by name (last), the other balance's variables as
    `other:role`.
    """
    if effect.joins(target):
        variables = balance_variables(
            simulator, simulator.model.balances[tied_to(target)[0]], experiment, X
        )
        return {f"other:{role}": values for role, values in variables.items()}
    known = {name: X[:, k] for k, name in enumerate(simulator.states)}
    # Signals that are computed are asked for only where neither a state nor an input has the name.
    known |= {name: experiment.U[:, k] for k, name in enumerate(simulator.model.inputs)}
    look = (
        simulator.look(experiment, X) if any(name not in known for name in tied_to(target)) else {}
    )
    return {name: known[name] if name in known else look[name] for name in tied_to(target)}


def balance_variables(
    simulator: Simulator, balance: Balance, experiment: Experiment, X: Array
) -> dict[str, Array]:
    """A balance's variables by role along the states X: with `supply`, `supply_terms`, `term:name`,
    and effects' own states.
    """
    model = simulator.model
    look = simulator.look(experiment, X)
    states = {name: X[:, k] for k, name in enumerate(simulator.states)}
    inputs = {name: experiment.U[:, k] for k, name in enumerate(model.inputs)}
    known = states | {n: look[n] for n in look if "." not in n} | inputs
    by_role = {
        role: _value(model, name, known, experiment.n) for role, name in balance.variables.items()
    }
    for use in model.effects:
        if use.effect.place == "balance" and use.place == balance.name:
            by_role |= _inside(states, f"{use.label}.")
    by_role |= _of_supply(model, balance, inputs, look)
    # Every term of the balance, those of effects included.
    by_role |= {f"term:{name}": z for name, z in _inside(look, f"{balance.name}.").items()}
    return by_role | {name: inputs[name] for name in ("conveyor", "door") if name in inputs}


def _of_supply(
    model: PhysicalModel, balance: Balance, inputs: Mapping[str, Array], look: Mapping[str, Array]
) -> dict[str, Array]:
    """What drives a balance, and the sum of the terms that it stands in; nothing where no input
    drives it.
    """
    supply = model.supply_input(balance)
    if supply is None:
        return {}
    with_input = [name for name, term in balance.terms.items() if supply in term.names]
    terms = np.sum([look[f"{balance.name}.{name}"] for name in with_input], axis=0)
    return {"supply": inputs[supply], "supply_terms": terms}


def _inside(values: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """Those whose name begins so, by the rest of it."""
    return {name.removeprefix(prefix): x for name, x in values.items() if name.startswith(prefix)}


def _value(model: PhysicalModel, name: str, known: dict[str, Array], n: int) -> Array:
    # An absent input stands for its default: a parameter, or a number.
    signal = model.inputs.get(name)
    if signal is not None and signal.absent and signal.default is not None:
        name = signal.default
    if name in known:
        return known[name]
    return np.full(n, model.parameters[name].value if name in model.parameters else float(name))


def _rms(signal: Array) -> float:
    return float(np.sqrt(np.mean(signal**2)))
