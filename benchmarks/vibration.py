"""Vibration: speed and memory beside PySDKit and SciPy; bands found in noise; the pliers' Table 6; real bearings."""

import resource
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import fft, signal
from scipy.io import loadmat
from sklearn.metrics import roc_auc_score

from benchmarks.peers import run_peer
from benchmarks.peers.band_selection import MERITS, choose_band, separation
from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.diagnosers.gripping_pliers import GrippingPliers
from residuum.diagnosis.vibration.bearing_lines import orders_from_geometry
from residuum.diagnosis.vibration.moving_lines import faulty_bearing, impact_train
from residuum.diagnosis.vibration.spectra import band_envelope, kurtogram
from residuum.diagnosis.vibration.vibration_indicators import indicators
from residuum.identification.record import Record
from residuum.simulation.gripping_pliers import GrippingPliers as Machine

N, RATE = 2_300_000, 12800.0
PRIME = 2_300_003
MACHINES = 60
ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
RIG = Path(__file__).resolve().parents[2] / "shared" / "data" / "cwru"
PYSDKIT = f"""
import json, time, numpy as np
from pysdkit.utils import fast_kurtogram
x = np.random.default_rng(0).standard_normal({N})
started, cpu = time.perf_counter(), time.process_time()
fast_kurtogram(x, fs={RATE}, nlevel=7)
print(json.dumps([time.perf_counter() - started, time.process_time() - cpu]))
"""


def median_seconds(job: Callable[[], object], repeats: int = 5) -> float:
    job()
    spent = []
    for _ in range(repeats):
        started = time.perf_counter()
        job()
        spent.append(time.perf_counter() - started)
    return float(np.median(spent))


def least_cpu(job: Callable[[], object], repeats: int = 9) -> float:
    """Least CPU seconds of all threads: what other work on the machine adds is never negative."""
    return min(_cpu(job) for _ in range(repeats))


def _cpu(job: Callable[[], object]) -> float:
    started = time.process_time()
    job()
    return time.process_time() - started


def megabytes(job: Callable[[], object]) -> float:
    tracemalloc.start()
    job()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def by_scipy(x: np.ndarray) -> np.ndarray:
    sections = signal.butter(4, [1467, 1600], "bandpass", fs=RATE, output="sos")
    envelope = np.abs(signal.hilbert(signal.sosfiltfilt(sections, x)))
    return np.abs(np.fft.rfft(envelope**2))


def speed() -> None:
    double = np.random.default_rng(0).standard_normal(N)
    single, prime = double.astype(np.float32), np.random.default_rng(1).standard_normal(PRIME)
    jobs: dict[str, Callable[[], object]] = {
        "kurtogram, 7 levels, filter bank, double": lambda: kurtogram(double, RATE, 7),
        "kurtogram, 7 levels, filter bank, single": lambda: kurtogram(single, RATE, 7),
        "kurtogram, 7 levels, FFT bands, double": lambda: kurtogram(double, RATE, 7, method="fft"),
        "kurtogram, 7 levels, FFT bands, single": lambda: kurtogram(single, RATE, 7, method="fft"),
        "band-pass + envelope + spectrum, double": lambda: band_envelope(
            double, RATE, 1467, 1600
        ).spectrum(),
        "band-pass + envelope + spectrum, single": lambda: band_envelope(
            single, RATE, 1467, 1600
        ).spectrum(),
        "band-pass + envelope + spectrum, prime length": lambda: band_envelope(
            prime, RATE, 1467, 1600
        ).spectrum(),
        "the same by Butterworth, Hilbert and FFT (SciPy)": lambda: by_scipy(double),
        "scipy.fft.rfft of 2304000 samples alone, double": lambda: fft.rfft(double, 2_304_000),
        "scipy.fft.rfft of 2304000 samples alone, single": lambda: fft.rfft(single, 2_304_000),
        "RMS, kurtosis, crest, impulsiveness": lambda: indicators(double),
    }
    print(
        f"| job ({N} samples) | seconds | CPU seconds, all threads, least of 9 | MB above the signal |\n|---|---|---|---|"
    )
    for name, job in jobs.items():
        print(
            f"| {name} | {median_seconds(job):.3f} | {least_cpu(job):.3f} | {megabytes(job):.0f} |"
        )
    peer = run_peer("pysdkit", ["pysdkit==0.5.0"], PYSDKIT)
    print(
        f"| kurtogram, PySDKit 0.5.0 | {'not installed | ' if peer is None else f'{peer[0]:.3f} | {peer[1]:.3f}'} | |\n"
    )


def bands() -> None:
    print(
        "Resonance of 3.2 kHz found (best band holds it), of 20; 107 impacts a second, 2 s at 12.8 kHz\n"
    )
    print(
        f"| SNR, knocks | {' | '.join(MERITS)} | separation (5 healthy records) |\n|---|{'---|' * (len(MERITS) + 1)}"
    )
    n = int(2 * RATE)
    for snr, knocks in ((0, 0), (-10, 0), (-14, 0), (0, 3)):
        hits = dict.fromkeys((*MERITS, "separation"), 0)
        for seed in range(20):
            rng = np.random.default_rng([seed, 7])
            healthy = [
                kurtogram(rng.standard_normal(n), RATE, 4, segments=16, method="fft")
                for _ in range(5)
            ]
            x = rng.standard_normal(n) + 10 ** (snr / 20) * impact_train(
                n, RATE, 107.0, resonance=3200, seed=seed
            )
            for _ in range(knocks):
                at, k = rng.integers(0, n - 400), np.arange(400) / RATE
                f = rng.uniform(800, 5500)
                x[at : at + 400] += 20 * np.exp(-0.3 * f * k) * np.sin(2 * np.pi * f * k)
            current = kurtogram(x, RATE, 4, segments=16, method="fft")
            found = {merit: choose_band(x, RATE, merit=merit)[0] for merit in MERITS}
            found["separation"] = next(current.in_order(separation(current, healthy)))
            for name, band in found.items():
                hits[name] += band.level > 0 and band.low <= 3200 <= band.high
        print(f"| {snr} dB, {knocks} | {' | '.join(str(count) for count in hits.values())} |")
    print()


def record_of(seconds: float, seed: int, **settings: object) -> Record:
    signals = Machine(seed=seed, **settings).simulate(seconds)  # type: ignore[arg-type]
    return Record(signals.channels, signals.units, signals.sample_time)


def pliers() -> None:
    damaged = {"plier-bearing": 1.0}
    tests = [record_of(180.0, seed, preforms_after=40.0) for seed in (1, 2)]
    faulty = record_of(180.0, 3, preforms_after=40.0, faults=damaged)
    judge = GrippingPliers().fit([*tests, faulty], ["healthy", "healthy", "plier-bearing"])
    print(
        f"Table 6: band {judge.band.centre:.0f} Hz, width {judge.band.width:.0f} Hz (source 1533, 133)\n"
    )
    print("| | H1 | H2 | F | variation | source |\n|---|---|---|---|---|---|")
    envelopes = [
        band_envelope(
            r["acceleration"], RATE, judge.band.low, judge.band.high, decimate=False
        ).values
        for r in (*tests, faulty)
    ]
    found = [indicators(envelope) for envelope in envelopes]
    for name, unit, gain, source in (
        ("kurtosis", "", 1.0, "+1617 %"),
        ("rms", " [g]", 1 / 9.80665, "+120 %"),
    ):
        h1, h2, f = (gain * getattr(each, name) for each in found)
        print(
            f"| {name}{unit} | {h1:.3g} | {h2:.3g} | {f:.3g} | {100 * (2 * f / (h1 + h2) - 1):+.0f} % | {source} |"
        )
    compared = judge.compare(faulty)
    print(
        f"\nenvelope RMS by quadrant, faulty, median [m/s²]: {np.round(np.median(compared.quadrant_rms, axis=0), 4).tolist()}"
    )
    whole = least_cpu(lambda: judge.score(faulty), 3)
    print(
        f"a 3-minute test scored whole: {median_seconds(lambda: judge.score(faulty), 3):.2f} s, {whole:.2f} s of CPU"
    )
    one = faulty.window(0, 38400)
    seconds, cpu = median_seconds(lambda: judge.score(one), 9), least_cpu(lambda: judge.score(one))
    print(
        f"one window of 3 s (one round): {1000 * seconds:.1f} ms, {1000 * cpu:.1f} ms of CPU, so one core follows "
        f"{int(2.0 / cpu)} channels of 12.8 kHz"
    )
    limits = GrippingPliers().fit([record_of(60.0, 4)])
    alarms = [limits.score(record_of(1200.0, seed)).evidence for seed in (5, 6, 7)]
    total, over = (
        sum(each["rounds"] for each in alarms),
        sum(each["exceeding_rounds"] for each in alarms),
    )
    print(f"healthy rounds over a limit: {over} of {total}; trained on 60 s\n")


def real_bearings() -> None:
    if not RIG.is_dir():
        print("skipped: no real recordings here\n")
        return
    parts = {}
    for file in ("97_Normal_0", "105_0", "130_0"):
        x = next(
            value.ravel()
            for key, value in loadmat(RIG / f"{file}.mat").items()
            if key.endswith("DE_time")
        )
        parts[file] = [
            Record({"a": x[k : k + 12000]}, {"a": "g"}, 1 / 12000)
            for k in range(0, x.size - 11999, 12000)
        ]
    healthy = parts.pop("97_Normal_0")
    judges = {
        "baseline of half of 97": Bearing(orders=ORDERS, speed_rpm=1796).fit(healthy[::2]),
        "none": Bearing(orders=ORDERS, speed_rpm=1796),
    }
    print(
        "| baseline | recording | windows | named right | AUC against held-out 97 |\n|---|---|---|---|---|"
    )
    for name, judge in judges.items():
        calm = [judge.score(window) for window in healthy[1::2]]
        print(
            f"| {name} | 97, held out | {len(calm)} | {sum(finding.verdict == 'healthy' for finding in calm)} | |"
        )
        for (file, windows), part in zip(parts.items(), ("inner-race", "outer-race"), strict=True):
            findings = [judge.score(window) for window in windows]
            scores = [finding.indicators["severity"] for finding in (*calm, *findings)]
            auc = roc_auc_score([0] * len(calm) + [1] * len(findings), scores)
            print(
                f"| {name} | {file} | {len(findings)} | {sum(finding.fault_class == part for finding in findings)} | {auc:.4f} |"
            )
    print()


def healthy_machine(
    kind: str, n: int, rate: float, shaft: float, rng: np.random.Generator
) -> np.ndarray:
    """Vibration of a machine without a bearing fault, of one of the kinds that imitate one."""
    t, x = np.arange(n) / rate, rng.standard_normal(n)
    if kind == "coloured":
        low, high = np.sort(rng.uniform(0.02, 0.35, 2)) * rate
        sos = signal.butter(2, [low, max(high, 1.3 * low)], "bandpass", fs=rate, output="sos")
        x = signal.sosfilt(sos, x) * 5 + 0.3 * x
    elif kind in ("gear on the shaft", "gear on another shaft"):
        turning = shaft if kind == "gear on the shaft" else shaft / rng.uniform(1.5, 6.0)
        teeth = int(rng.integers(17, 60))
        mesh = (1 + 0.5 * np.cos(2 * np.pi * turning * t)) * np.cos(2 * np.pi * teeth * turning * t)
        x += rng.uniform(0.5, 3.0) * mesh
    elif kind == "shaft-modulated":
        x *= 1 + rng.uniform(0.2, 0.8) * np.cos(2 * np.pi * shaft * t + rng.uniform(0, 6))
    elif kind == "knocks":
        for _ in range(int(rng.integers(1, 6))):
            at, f = int(rng.integers(0, n - 400)), rng.uniform(0.05, 0.4) * rate
            k = np.arange(400) / rate
            x[at : at + 400] += (
                rng.uniform(5, 25) * np.exp(-0.3 * f * k) * np.sin(2 * np.pi * f * k)
            )
    elif kind == "slow swell":
        x *= np.exp(signal.lfilter([0.002], [1, -0.998], rng.standard_normal(n)) * 8)
    elif kind == "mains hum":
        for harmonic in (1, 3, 5):
            x += (
                rng.uniform(0.2, 0.8)
                / harmonic
                * np.cos(2 * np.pi * 50 * harmonic * t + rng.uniform(0, 6))
            )
        x *= 1 + 0.1 * np.cos(2 * np.pi * 100 * t)
    return x


HEALTHY = (
    "white", "coloured", "gear on the shaft", "shaft-modulated", "knocks", "slow swell", "mains hum", "gear on another shaft"
)  # fmt: skip


def false_lines() -> None:
    """Largest prominence on healthy machines of many geometries, speeds and rates, and lines named by mistake."""
    print(
        f"Healthy machines, {MACHINES} of each kind: 7–13 balls, shafts of 8–60 Hz, 10–48.8 kHz, 1–4 s, no baseline\n"
    )
    print("| kind | largest prominence | a part named | called faulty |\n|---|---|---|---|")
    for kind in HEALTHY:
        largest, named, faulty = 0.0, 0, 0
        for seed in range(MACHINES):
            rng = np.random.default_rng([seed, 17])
            orders = orders_from_geometry(int(rng.integers(7, 14)), rng.uniform(0.15, 0.3), 1.0)
            rate, shaft = float(rng.choice([10_000, 12_800, 25_600, 48_828])), rng.uniform(8, 60)
            x = healthy_machine(kind, int(rate * rng.uniform(1, 4)), rate, shaft, rng)
            found = Bearing(orders=orders, speed_rpm=60 * shaft).score(
                Record({"a": x}, {"a": "g"}, 1 / rate)
            )
            largest = max(
                [
                    largest,
                    *(
                        value
                        for name, value in found.indicators.items()
                        if name.startswith("prominence")
                    ),
                ]
            )
            named += found.fault_class not in (None, "unknown")
            faulty += found.verdict == "faulty"
        print(f"| {kind} | {largest:.1f} | {named} | {faulty} |")
    print()


def named_at_low_snr() -> None:
    """How often the damaged part is named, on two rigs."""
    print(
        f"Damaged parts named without a baseline, of {MACHINES // 3} each (impacts against white noise over the whole band)\n"
    )
    print("| rig | SNR | inner race | outer race | ball | cage |\n|---|---|---|---|---|---|")
    for rate, shaft, balls, ratio, seconds in (
        (12_000, 29.95, 9, 0.2034, 1.0),
        (48_828, 25.0, 8, 0.1888, 3.0),
    ):
        orders = orders_from_geometry(balls, ratio, 1.0)
        judge = Bearing(orders=orders, speed_rpm=60 * shaft)
        for snr in (0.0, -6.0, -10.0, -14.0):
            right = []
            for fault, part in (
                ("bpfi", "inner-race"),
                ("bpfo", "outer-race"),
                ("bsf", "ball"),
                ("ftf", "cage"),
            ):
                records = [
                    faulty_bearing(
                        int(rate * seconds), rate, shaft, orders, fault, snr_db=snr, seed=seed
                    )  # type: ignore[arg-type]
                    for seed in range(MACHINES // 3)
                ]
                found = [
                    judge.score(Record({"a": x}, {"a": "g"}, 1 / rate)).fault_class for x in records
                ]
                right.append(found.count(part))
            print(
                f"| {rate / 1000:g} kHz, {shaft:g} Hz, {seconds:g} s | {snr:g} dB | {' | '.join(map(str, right))} |"
            )
    print()


def long_recording() -> None:
    """10⁸ samples, single precision, a fault in the last tenth."""
    rate, shaft = 12_800.0, 30.0
    part = 1_000_000
    healthy, broken = (
        faulty_bearing(part, rate, shaft, ORDERS, fault, seed=1).astype(np.float32)
        for fault in (None, "bpfo")
    )
    x = np.concatenate([np.tile(healthy, 90), np.tile(broken, 10)])
    record = Record({"a": x}, {"a": "g"}, 1 / rate)
    judge = Bearing(orders=ORDERS, speed_rpm=60 * shaft)
    judge.score(record.window(0, 100_000))
    began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.process_time()
    found = judge.score(record)
    spent, grown = (
        time.process_time() - started,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - began,
    )
    print(
        f"{x.size:.0e} samples ({x.size / rate / 3600:.1f} h): {spent:.0f} s of CPU, {grown / 1024:.0f} MB above the record; ",
        end="",
    )
    print(f"{found.verdict.value}, {found.fault_class}: {found.reason}\n")


def main() -> None:
    print("# Vibration\n")
    speed()
    bands()
    pliers()
    real_bearings()
    false_lines()
    named_at_low_snr()
    long_recording()


if __name__ == "__main__":
    main()
