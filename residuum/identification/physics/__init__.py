"""Models made of balances: model file → equations → compiled kernel → simulation, sensitivities,
estimation.

The way through::

    model = load_model("gate-drive")                       # or a YAML file: PhysicalModel
    # columns → inputs and outputs, in the model's units
    model, experiments = match(model, records, {"speed": "w"})
    # Estimate: values, covariance, flat directions, residuals
    result = estimate(model, experiments)
    better = model.with_effect("coulomb-friction", "shaft")
    # each balance's smoothed missing term with band
    unknown = missing_terms(result.model, experiments, result.initial)
    text = write_model(result.model)                       # YAML again, with effects and provenance

`candidates(model)` lists every (effect id, target) that fits; `Simulator(model).run(experiment,
slopes=[…])` gives outputs with their exact derivatives by parameters (full names as in
`model.all_parameters`), initial states (`initial:x`) and the additive missing term of each balance
(`missing@balance`). Modules: `expression`, `dimension`, `yaml_tree`, `model_file`, `consistency`
(reading), `model` (the type), `composition`, `code_generation`, `kernel` (compiling),
`integration`, `kalman_recursions` (compiled once), `experiment`, `simulation`, `estimation`,
`coloured_covariance`, `kalman`, `likelihood_estimation` (using), `effects/` (the catalogue).

Every name is loaded when it is first used: who asks for the catalogue needs no compiler.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from residuum.identification.physics.estimation.coloured_covariance import with_coloured_noise
    from residuum.identification.physics.estimation.estimation import (
        Estimate,
        Settings,
        estimate,
        windows,
    )
    from residuum.identification.physics.estimation.least_squares import FlatDirection
    from residuum.identification.physics.estimation.likelihood_estimation import (
        estimate_by_likelihood,
    )
    from residuum.identification.physics.files.model_file import (
        BUILT_IN,
        load_model,
        read_model,
        write_model,
    )
    from residuum.identification.physics.model import (
        EffectUse,
        Key,
        PhysicalModel,
        candidates,
        find_effect,
    )
    from residuum.identification.physics.simulate.experiment import (
        Experiment,
        block_means,
        match,
        measured_parts,
    )
    from residuum.identification.physics.simulate.kalman import (
        Filter,
        MissingTerm,
        Noise,
        Smoothed,
        missing_terms,
        noise_floor,
        tune,
    )
    from residuum.identification.physics.simulate.operating_conditions import (
        balance_variables,
        conditions_at,
    )
    from residuum.identification.physics.simulate.simulation import Simulation, Simulator

__all__ = [
    "BUILT_IN",
    "EffectUse",
    "Estimate",
    "Experiment",
    "Filter",
    "FlatDirection",
    "Key",
    "MissingTerm",
    "Noise",
    "PhysicalModel",
    "Settings",
    "Simulation",
    "Simulator",
    "Smoothed",
    "balance_variables",
    "candidates",
    "conditions_at",
    "estimate",
    "estimate_by_likelihood",
    "find_effect",
    "load_model",
    "block_means",
    "match",
    "measured_parts",
    "missing_terms",
    "noise_floor",
    "read_model",
    "tune",
    "windows",
    "with_coloured_noise",
    "write_model",
]

_PLACES = {
    "estimation.estimation": ("Estimate", "Settings", "estimate", "windows"),
    "estimation.least_squares": ("FlatDirection",),
    "estimation.likelihood_estimation": ("estimate_by_likelihood",),
    "files.model_file": ("BUILT_IN", "load_model", "read_model", "write_model"),
    "model": ("EffectUse", "Key", "PhysicalModel", "candidates", "find_effect"),
    "estimation.coloured_covariance": ("with_coloured_noise",),
    "simulate.experiment": ("Experiment", "block_means", "match", "measured_parts"),
    "simulate.kalman": (
        "Filter",
        "MissingTerm",
        "Noise",
        "Smoothed",
        "missing_terms",
        "noise_floor",
        "tune",
    ),
    "simulate.operating_conditions": ("balance_variables", "conditions_at"),
    "simulate.simulation": ("Simulation", "Simulator"),
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _PLACE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    attribute = getattr(import_module(f"{__name__}.{_PLACE[name]}"), name)
    globals()[name] = attribute
    return attribute
