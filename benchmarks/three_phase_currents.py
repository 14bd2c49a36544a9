"""Inter-turn shorts of a real motor from its three currents: 13 classes, leave-one-repeat-out, beside FFT + SVM and a forest."""

from pathlib import Path

import numpy as np
import scipy.io
from sklearn.base import BaseEstimator
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.ensemble import RandomForestClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from benchmarks.peers.current_signature import current_signature
from residuum.diagnosis.learning.diagnoser_validation import proportion_interval

FILE = Path(__file__).parents[2] / "shared" / "data" / "itsc" / "Data_ITSC.mat"
RATE, SUPPLY, WINDOW = 1000.0, 60.0, 250


def recordings(path: Path = FILE) -> tuple[list[np.ndarray], list[str], list[int]]:
    """Currents (1000, 3), class and repeat of each of the 65 recordings."""
    content = scipy.io.loadmat(path)["itsc"][0, 0]
    currents, labels, repeats = [], [], []
    for name in content.dtype.names:
        group = content[name][0, 0]
        for repeat, field in enumerate(group.dtype.names):
            currents.append(np.asarray(group[field], dtype=float))
            labels.append(name.removeprefix("ITSC_"))
            repeats.append(repeat)
    return currents, labels, repeats


def spectrum(window: np.ndarray) -> np.ndarray:
    return np.abs(np.fft.rfft(window * np.hanning(window.shape[0])[:, None], axis=0)).ravel()


def signature(window: np.ndarray) -> np.ndarray:
    return current_signature(window, 1 / RATE, SUPPLY)


def leave_one_repeat_out(
    estimator: BaseEstimator, features: list[np.ndarray], labels: list[str], repeats: list[int]
) -> list[str]:
    """Class of each recording: the most frequent one among its windows, by an estimator that saw none of that repeat."""
    said = [""] * len(labels)
    for repeat in sorted(set(repeats)):
        train = [k for k, r in enumerate(repeats) if r != repeat]
        X = np.concatenate([features[k] for k in train])
        y = np.concatenate([[labels[k]] * features[k].shape[0] for k in train])
        estimator.fit(X, y)
        for k in (k for k, r in enumerate(repeats) if r == repeat):
            votes, counts = np.unique(estimator.predict(features[k]), return_counts=True)
            said[k] = str(votes[np.argmax(counts)])
    return said


def main() -> None:
    print("# Inter-turn shorts of a three-phase motor (13 classes × 5 repeats)\n")
    if not FILE.is_file():
        print("skipped: no real recordings here")
        return
    currents, labels, repeats = recordings()
    windows = [np.split(record, record.shape[0] // WINDOW) for record in currents]
    signatures = [np.array([signature(window) for window in group]) for group in windows]
    spectra = [np.array([spectrum(window) for window in group]) for group in windows]
    methods = {
        "sequence currents + linear SVM": (
            make_pipeline(StandardScaler(), SVC(kernel="linear", C=10.0)),
            signatures,
        ),
        "sequence currents + shrunk LDA": (
            LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto"),
            signatures,
        ),
        "plain FFT + linear SVM": (
            make_pipeline(StandardScaler(), SVC(kernel="linear", C=10.0)),
            spectra,
        ),
        "plain FFT + RBF SVM": (make_pipeline(StandardScaler(), SVC(C=10.0)), spectra),
        "plain FFT + random forest": (RandomForestClassifier(300, random_state=0), spectra),
    }
    print("| method | recordings right | 95 % |\n|---|---|---|")
    for name, (estimator, features) in methods.items():
        said = leave_one_repeat_out(estimator, features, labels, repeats)
        right = sum(a == b for a, b in zip(said, labels, strict=True))
        low, high = proportion_interval(right, len(labels))
        print(
            f"| {name} | {right} of {len(labels)} = {100 * right / len(labels):.1f} % | {100 * low:.1f}–{100 * high:.1f} % |"
        )


if __name__ == "__main__":
    main()
