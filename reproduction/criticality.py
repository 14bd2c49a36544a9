"""Fig. 78: the criticality matrix of the gate actuator's failure modes."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from reproduction.check import Check, same
from reproduction.item import Item
from residuum.diagnosis.gate.fmeca import (
    PROBABILITIES,
    SEVERITIES,
    FailureMode,
    Risk,
    criticality_matrix,
    load_fmeca,
    risk,
)

SOURCE_CELLS = {
    "rack-tooth": ("D", "IV"),
    "pinion-tooth": ("D", "IV"),
    "broken-shaft": ("C", "I"),
    "nylon-gear": ("C", "III"),
    "motor-short-circuit": ("B", "I"),
    "corrupted-wheel": ("B", "III"),
}
SOURCE_CHOSEN = {"rack-tooth", "pinion-tooth", "nylon-gear"}


def criticality() -> Item:
    """The matrix with the source's cells, and what its colours leave to diagnosis."""
    modes = load_fmeca()
    rows = [("probability", *(f"{name} {said}" for name, said in SEVERITIES.items()))]
    cells = criticality_matrix(modes)
    for p, said in PROBABILITIES.items():
        rows.append(
            (
                f"{p} {said}",
                *(", ".join(mode.id for mode in cells[p, s]) or "–" for s in SEVERITIES),
            )
        )
    placed = {mode.id: (mode.probability, mode.severity) for mode in modes}
    chosen = {mode.id for mode in modes if mode.risk is not Risk.REDESIGN}
    order = [Risk.ACCEPTABLE, Risk.TOLERABLE, Risk.REDESIGN]
    levels = np.array(
        [[order.index(risk(p, severity)) for severity in SEVERITIES] for p in PROBABILITIES]
    )
    checks = [
        Check(
            "modes in the source's cell (entered from its text)",
            str(len(SOURCE_CELLS)),
            str(sum(placed.get(name) == cell for name, cell in SOURCE_CELLS.items())),
            placed == SOURCE_CELLS,
            by_construction=True,
        ),
        same(
            "modes that the rule of colours leaves to diagnosis",
            sorted(SOURCE_CHOSEN),
            sorted(chosen),
        ),
        same(
            "neighbouring cells where a graver or likelier mode has a lower risk",
            0,
            int(np.sum(np.diff(levels, axis=0) > 0) + np.sum(np.diff(levels, axis=1) > 0)),
        ),
    ]
    source = "rack and pinion D-IV, gear C-III to be diagnosed; shaft C-I, short circuit B-I, wheel B-III need a redesign"
    return Item("Fig. 78", "Criticality matrix (FMECA)", source, checks, "", rows, [_matrix(cells)])


def _matrix(cells: Mapping[tuple[str, str], Sequence[FailureMode]]) -> go.Figure:
    shades = {Risk.ACCEPTABLE: 0, Risk.TOLERABLE: 1, Risk.REDESIGN: 2}
    figure = go.Figure(
        layout={"xaxis_title": "severity", "yaxis_title": "probability", "height": 360}
    )
    figure.add_heatmap(
        x=list(SEVERITIES),
        y=list(PROBABILITIES),
        showscale=False,
        zmin=0,
        zmax=2,
        z=[[shades[risk(p, s)] for s in SEVERITIES] for p in PROBABILITIES],
        text=[
            ["<br>".join(mode.id for mode in cells[p, s]) for s in SEVERITIES]
            for p in PROBABILITIES
        ],
        texttemplate="%{text}",
        colorscale=[[0, "#bfe3c8"], [0.5, "#f5e6a3"], [1, "#f0b3a0"]],
    )
    figure.update_yaxes(autorange="reversed")
    return figure
