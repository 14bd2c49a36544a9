"""`python -m benchmarks [NAME…]`: run all benchmarks, or those named; each prints its tables as Markdown."""

import sys
from importlib import import_module

BENCHMARKS: dict[str, str] = {
    "gate_actuator": "gate actuator: accuracy on actuators never seen, false alarms, growing notch, speed",
    "three_phase_currents": "inter-turn shorts of a real motor beside FFT + SVM and a random forest",
    "hidden_effects": "effects hidden in simulated machines: named or missed, false blame, calibration",
    "explain": "how long explain takes on 60 s at 1 kHz, with an empty cache and with a filled one",
    "same_answers": "explain and improve with code compiled and not, one thread and two, idle and beside load: equal answers",
    "drawn_answers": "drawn models and records through four questions: faults, and rules that answers break",
    "published_models": "models that engineers published: simulated beside SciPy, and is what they lack named?",
    "policy_halves": "each number of the judge on unseen blocks halved and half as large again: which answers change",
    "real_records": "missing physics in real recordings: Silverbox beside published errors, a lamp that heats a plate",
    "ingest": "CPU and losses of the bus sources at the demo's full traffic",
    "identification": "kernel identification beside scikit-learn, impulseest and the textbook form; coverage of its bands",
    "prediction_error": "prediction error methods: coverage of the ellipsoids, order and fit on (2.38), real data beside peers",
    "vibration": "kurtogram and envelope beside PySDKit and SciPy; bands found in noise; Table 6; real bearings",
    "residuals": "residual methods: detection and delay at one false alarm a day, false-alarm rates, bound, estimate, speed",
    "residual_tails": "far tails of noise from healthy samples: rate of single samples against how many samples there were",
    "robust_control": "fixed-structure design beside differential evolution; Algorithms 2, 3; the guarantee on plants",
    "web": "the page in Chromium: bytes, first paint, zooming into a million samples, memory of twenty tabs",
    "http": "scoring a window over HTTP beside the framework's own routes",
}


def main() -> None:
    names = sys.argv[1:] or list(BENCHMARKS)
    if unknown := [name for name in names if name not in BENCHMARKS]:
        sys.exit(
            f"benchmark {unknown[0]!r}: there is none of this name; known are {', '.join(BENCHMARKS)}"
        )
    for name in names:
        import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()
