"""Peers of the model-based diagnoser on windows of any machine: each gives a number a window, larger the stranger.

Kalman innovations with CUSUM use the same model, estimated on the same windows; the others know signals alone. Features of a
window: mean, standard deviation, least and largest value of each channel, and the correlations of channels and of their
differences.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
from sklearn.decomposition import PCA
from sklearn.ensemble import IsolationForest
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import StandardScaler

from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.identification.physics import match
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]
Score = Callable[[Record], float]
_SLACK = 0.1


def peers(baseline: Baseline, healthy: Sequence[Record]) -> dict[str, Score]:
    """Trained peers by name."""
    found = {"innovations + CUSUM": innovations_cusum(baseline, healthy), **on_features(healthy)}
    robust = robust_residual(baseline, healthy)
    return found | ({"robust-residual": robust} if robust else {})


def innovations_cusum(baseline: Baseline, healthy: Sequence[Record]) -> Score:
    """Largest two-sided CUSUM of each output's innovations, in healthy standard deviations."""
    tracking = baseline.tracking

    def rows(record: Record) -> Array:
        _, (e,) = match(tracking.model, [record])
        return np.nan_to_num(tracking.run(e, slopes=False).normalised)

    each = [rows(r) for r in healthy]
    mean, std = np.mean(np.concatenate(each), axis=0), np.std(np.concatenate(each), axis=0) + 1e-12

    def score(record: Record) -> float:
        z = (rows(record) - mean) / std
        both = np.concatenate([z - _SLACK, -z - _SLACK], axis=1)
        walk = np.vstack([np.zeros(both.shape[1]), np.cumsum(both, axis=0)])
        return float(np.max(walk - np.minimum.accumulate(walk, axis=0)))

    return score


def features(record: Record) -> Array:
    """Of one window."""
    X = np.column_stack([record[n] for n in record.names])
    found = [X.mean(axis=0), X.std(axis=0), X.min(axis=0), X.max(axis=0)]
    with np.errstate(invalid="ignore", divide="ignore"):
        for Z in (X, np.diff(X, axis=0)):
            C = np.nan_to_num(np.corrcoef(Z.T))
            found.append(np.array([C[i, j] for i, j in combinations(range(X.shape[1]), 2)]))
    return np.concatenate(found)


def on_features(healthy: Sequence[Record]) -> dict[str, Score]:
    """PCA (T² and SPE, each over its healthy mean), an autoencoder, an isolation forest."""
    F = np.array([features(r) for r in healthy])
    scaler = StandardScaler().fit(F)
    Z = scaler.transform(F)
    pca = PCA(0.9).fit(Z)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        coder = MLPRegressor(hidden_layer_sizes=(8, 3, 8), activation="tanh", alpha=1e-2, max_iter=2000, random_state=0).fit(Z, Z)
    forest = IsolationForest(random_state=0).fit(Z)

    def monitored(z: Array) -> tuple[float, float]:
        t = pca.transform(z)
        return float(np.sum(t**2 / pca.explained_variance_)), float(np.sum((z - pca.inverse_transform(t)) ** 2))

    usual = np.mean([monitored(z[None]) for z in Z], axis=0) + 1e-12
    return {
        "PCA T²/SPE": lambda r: float(np.max(np.array(monitored(scaler.transform(features(r)[None]))) / usual)),
        "autoencoder": lambda r: _left(coder, scaler.transform(features(r)[None])),
        "isolation forest": lambda r: -float(forest.score_samples(scaler.transform(features(r)[None]))[0]),
    }


def _left(coder: MLPRegressor, z: Array) -> float:
    return float(np.sum((z - coder.predict(z).reshape(z.shape)) ** 2))


def robust_residual(baseline: Baseline, healthy: Sequence[Record]) -> Score | None:
    """Of the first input and the first output; None where it cannot be trained."""
    model = baseline.tracking.model
    u, y = next(iter(model.inputs)), next(iter(model.outputs))
    try:
        trained = RobustResidual(input=u, output=y).fit(healthy)
    except Exception as error:  # a peer that fails on a machine is said to
        print(f"  robust-residual cannot be trained: {error}")
        return None
    return lambda r: float(next(iter(trained.score(r).indicators.values()), np.nan))
