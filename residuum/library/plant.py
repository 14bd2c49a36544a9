"""Linear models of a plant from records, with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from residuum.identification.kernel_based.multivariable import (
    MultivariableModel,
    identify_multivariable,
    multivariable_text,
)
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import (
    identified_text,
    load_identified,
)
from residuum.identification.record import Record
from residuum.identification.record import Record as MeasuredRecord
from residuum.library.answers.identification import (
    identification_json,
    identification_text,
    static_gain,
)
from residuum.library.identification_methods import identified_by, with_uncertainty
from residuum.library.model_assumptions import (
    Assumptions,
    ModelCheck,
    assumptions,
    check_stable,
    model_check,
    parts_kept_aside,
    plant_tests,
    with_remarks,
)
from residuum.library.optional_package import need
from residuum.library.picture import Curve, Panel, Picture, axis
from residuum.library.plotly_figure import figure
from residuum.library.progress import Progress, Tell, progress_shown
from residuum.library.questions import asks
from residuum.library.questions.identify import LAGS, METHODS, Identify
from residuum.library.reading import as_records
from residuum.library.result import Result, Row
from residuum.library.whole_file import write_whole

# Linear models of several inputs and outputs, as an answer.

# Standard deviations of a 95 % band.
_BAND = 1.96


def _gain_std(path: IdentifiedModel) -> float:
    """Standard deviation of the static gain; a variance may be rounded below 0."""
    return float(np.sqrt(max(path.frequency_covariance(0.0)[0, 0, 0], 0.0)))


def _relative_gains(gains: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    """The relative gain array Λ = G ∘ (G⁻¹)ᵀ of a square plant (Bristol, 1966); None where there is
    no inverse.
    """
    invertible = gains.shape[0] == gains.shape[1] and abs(np.linalg.det(gains)) > 0
    return gains * np.linalg.inv(gains).T if invertible else None


@dataclass(frozen=True, eq=False, repr=False)
class MultivariablePlant(Result):
    """Linear models from every input to every output, which know how far to trust them.

    Attributes
    ----------
    identified : MultivariableModel
        `identified.models[i][j]` leads from input j to output i.
    estimation, held_out : tuple of Record
        What it was identified from, and what the records' split notes kept.

    Examples
    --------
    >>> import numpy as np, residuum as rs
    >>> u, w = np.random.default_rng(0).normal(size=(2, 300))
    >>> y = np.r_[0.0, 0.5 * u[:-1] + 0.2 * w[:-1]]
    >>> units = {"u": "V", "w": "V", "y": "K"}
    >>> record = rs.from_arrays({"u": u, "w": w, "y": y}, units=units, sample_time=1.0)
    >>> plant = rs.identify(record, input=["u", "w"], output="y", order=5)
    >>> [[round(gain, 2) for gain in row] for row in plant.to_dict()["static_gain"]]
    [[0.5, 0.2]]
    """

    identified: MultivariableModel
    estimation: tuple[Record, ...] = ()
    held_out: tuple[Record, ...] = ()

    def text(self) -> str:
        """The JSON text that `save` writes."""
        return multivariable_text(self.identified)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON file `path` that `residuum residual` and `residuum control` read.

        Parameters
        ----------
        path : str or path
        """
        write_whole(Path(path), self.text())

    def _answer(self) -> dict[str, Any]:
        """Every path's static gain with its deviation, each output's fit, and the relative gain
        array of a square plant.
        """
        model = self.identified
        rows = model.models
        first_path = rows[0][0]
        gains = model.frequency_response([0.0])[0].real
        return {
            "method": "kernel",
            "inputs": [{"name": path.input_name, "unit": path.input_unit} for path in rows[0]],
            "outputs": [{"name": row[0].output_name, "unit": row[0].output_unit} for row in rows],
            "sample_time": first_path.sample_time,
            "order": first_path.order,
            "static_gain": gains,
            "static_gain_std": [[_gain_std(path) for path in row] for row in rows],
            "relative_gains": _relative_gains(gains),
            "noise_variance": [row[0].noise_variance for row in rows],
            "impulse_responses": [[path.impulse_response for path in row] for row in rows],
            "fit_percent": [_fits(model, record) for record in self.estimation],
            "held_out_fit_percent": [_fits(model, record) for record in self.held_out],
            "file": None,
        }

    def __str__(self) -> str:
        return self.report(self._answer())

    def report(self, result: dict[str, Any]) -> str:
        """The short human report of an answer of `to_dict`, which may name the model's file.

        Parameters
        ----------
        result : dict
            As `to_dict` gives it.
        """
        inputs = [channel["name"] for channel in result["inputs"]]
        outputs = [channel["name"] for channel in result["outputs"]]
        lines = [
            f"kernel: {', '.join(inputs)} → {', '.join(outputs)}, {result['order']} coefficients a"
            " path"
        ]
        for i, output in enumerate(outputs):
            gains = ", ".join(
                f"{name} {result['static_gain'][i][j]:.4g} ± {result['static_gain_std'][i][j]:.2g}"
                for j, name in enumerate(inputs)
            )
            fits = ", ".join(f"{fit[output]:.2f} %" for fit in result["fit_percent"])
            lines.append(f"  {output}: static gain of {gains}; fit {fits}")
        if result["relative_gains"] is not None:
            rows = "; ".join(
                ", ".join(f"{value:.3g}" for value in row) for row in result["relative_gains"]
            )
            lines.append(f"  relative gains (rows: outputs) {rows}")
        return "\n".join([*lines, *([f"  written to {result['file']}"] if result["file"] else [])])

    def _paths(self) -> list[IdentifiedModel]:
        return [path for row in self.identified.models for path in row]

    def _rows(self) -> Sequence[Row]:
        answer = self._answer()
        gains, spreads = (np.ravel(answer[name]) for name in ("static_gain", "static_gain_std"))
        return [
            {
                "input": path.input_name,
                "output": path.output_name,
                "static_gain": float(gain),
                "std": float(std),
            }
            for path, gain, std in zip(self._paths(), gains, spreads, strict=True)
        ]

    def _picture(self) -> Picture:
        return Picture([response_panel(path) for path in self._paths()])


def response_panel(model: IdentifiedModel) -> Panel:
    """The impulse response of a model with its 95 % band."""
    times = model.sample_time * (model.delay + np.arange(model.order))
    g, spread = model.impulse_response, _BAND * model.std
    title = f"impulse response, {model.input_name} → {model.output_name}"
    return Panel(
        title,
        "time [s]",
        axis("g", gain_unit(model)),
        [Curve("impulse response", times, g, g - spread, g + spread)],
    )


def gain_unit(model: IdentifiedModel) -> str:
    """Output unit over input unit; empty where neither channel has one."""
    return (
        f"{model.output_unit or '1'}/{model.input_unit or '1'}"
        if model.output_unit or model.input_unit
        else ""
    )


def multivariable_plant(
    estimation: Sequence[Record], held_out: Sequence[Record], asked: Identify
) -> MultivariablePlant:
    """One kernel model of every path."""
    model = identify_multivariable(
        estimation,
        asked.inputs,
        asked.outputs,
        kernel=asked.kernel,
        order=LAGS if asked.order is None else asked.order,
        # Delays are estimated for a single path alone.
        delay=1 if asked.delay is None else asked.delay,
        noise_variance=asked.noise_variance,
        offset=asked.offset,
    )
    return MultivariablePlant(model, tuple(estimation), tuple(held_out))


def _fits(model: MultivariableModel, record: Record) -> dict[str, float]:
    """100 (1 − ‖y − ŷ‖/‖y − mean‖) of each output, where every input's past is known."""
    memory = max(path.delay + path.order for row in model.models for path in row)
    simulated = model.simulate(record)
    fits = {}
    for name, predicted in simulated.items():
        y = record[name][memory:]
        error = y - predicted[memory:]
        # Missing samples of an input predict nothing, those of the output cannot be compared.
        good = np.isfinite(error)
        fits[name] = float(
            100 * (1 - np.linalg.norm(error[good]) / np.linalg.norm(y[good] - np.mean(y[good])))
        )
    return fits


if TYPE_CHECKING:
    import plotly.graph_objects

# Frequencies of a response that is drawn.
_FREQUENCIES = 300


@dataclass(frozen=True, eq=False, repr=False)
class Plant(Result):
    """A linear model from one input to one output that knows how far to trust it.

    Attributes
    ----------
    identified : IdentifiedModel
        Impulse response with covariance, noise variance, numerator and denominator of a parametric
        method.
    method : str
        `kernel`, `ridge`, `lasso`, `elastic-net`, `set-membership`, `stochastic-embedding`, `ar`,
        `arx`, `fir`, `armax`, `oe` or `bj`.
    estimation, held_out : tuple of Record
        What it was identified from, and what the records' split notes kept.
    assumptions : Assumptions or None
        What the records say of integrators, feedback and dead time, and data kept aside of the fit.
    check : ModelCheck or None
        Residual tests, model error model and bootstrap, where they were asked for.

    Examples
    --------
    >>> import residuum as rs
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    >>> plant.sample(100).shape, plant.to_dict()["order"]
    ((100, 40), 40)
    """

    identified: IdentifiedModel
    method: str
    estimation: tuple[MeasuredRecord, ...] = ()
    held_out: tuple[MeasuredRecord, ...] = ()
    assumptions: Assumptions | None = None
    check: ModelCheck | None = None

    @property
    def impulse_response(self) -> npt.NDArray[np.float64]:
        """g, shape (order,), in output unit over input unit; `g[0]` acts at lag
        `identified.delay`.
        """
        return self.identified.impulse_response

    @property
    def std(self) -> npt.NDArray[np.float64]:
        """Standard deviation of g, shape (order,)."""
        return self.identified.std

    def frequency_response(self, omega: npt.ArrayLike) -> npt.NDArray[np.complex128]:
        """G at ω [rad/s], shape of `omega`.

        Parameters
        ----------
        omega : array
            [rad/s]

        Returns
        -------
        complex array, shape of `omega`

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> plant.frequency_response([0.1, 1.0]).shape
        (2,)
        """
        return self.identified.frequency_response(omega)

    def sample(self, n: int, seed: int = 0) -> npt.NDArray[np.float64]:
        """`n` impulse responses drawn from the distribution of the estimate by the random numbers
        of `seed`, shape (n, order).

        Parameters
        ----------
        n : int
        seed : int

        Returns
        -------
        array, shape (n, order)
            In output unit over input unit.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> plant.sample(5).shape
        (5, 40)
        """
        return self.identified.sample(n, seed)

    def to_control(self) -> Any:
        """The same system as a python-control `TransferFunction`; MissingPackage when `control` is
        not installed.

        Returns
        -------
        control.TransferFunction

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> type(plant.to_control()).__name__
        'TransferFunction'
        """
        return to_control(self.identified.transfer_function())

    def save(self, path: str | PathLike[str]) -> None:
        """Write the JSON file `path` that `rs.load_plant`, `residuum residual` and `residuum
        control` read.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        BadInput
            The folder of `path` does not exist.

        Examples
        --------
        See `load_plant`.

        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> plant.save("/no/such/folder/plant.json")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        residuum.identification.errors.BadInput: ...
        """
        write_whole(Path(path), self.text())

    def text(self) -> str:
        """The JSON text that `save` writes.

        Returns
        -------
        str

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> plant.text().startswith('{"format"')
        True
        """
        return identified_text(self.identified)

    def bode(self, frequencies: npt.ArrayLike | None = None) -> plotly.graph_objects.Figure:
        """Magnitude and phase over frequency with their 95 % bands, as a Plotly figure.

        Parameters
        ----------
        frequencies : array, shape (n,)
            In Hz; None: three decades up to half the sampling rate.

        Returns
        -------
        plotly.graph_objects.Figure

        Raises
        ------
        MissingPackage
            Plotly is not installed.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> [axis.title.text for axis in plant.bode([0.1, 1.0]).select_yaxes()]
        ['magnitude [dB]', 'phase [°]']
        """
        nyquist = 0.5 / self.identified.sample_time
        given = (
            np.geomspace(nyquist / 1000.0, nyquist, _FREQUENCIES)
            if frequencies is None
            else frequencies
        )
        hertz = np.atleast_1d(np.asarray(given, dtype=float))
        omega = 2.0 * np.pi * hertz
        G, covariance = (
            self.identified.frequency_response(omega),
            self.identified.frequency_covariance(omega),
        )
        # A response of exactly zero has no direction, and no decibels.
        size = np.maximum(np.abs(G), 1e-300)
        # The covariance of (Re G, Im G) is taken along G, where it moves the magnitude, and across
        # it, where it turns the phase.
        along = np.stack([G.real, G.imag], axis=1) / size[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        spread = [
            np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", d, covariance, d), 0.0))
            for d in (along, across)
        ]
        # A band that reaches a gain of zero would have no lower end in decibels: it ends 60 dB
        # below.
        low, high = (
            20.0 * np.log10(np.maximum(size + s * _BAND * spread[0], 1e-3 * size))
            for s in (-1.0, 1.0)
        )
        # Half a turn to either side already says that the phase is not known.
        phase, turn = (
            np.degrees(np.unwrap(np.angle(G))),
            np.degrees(np.minimum(_BAND * spread[1] / size, np.pi)),
        )
        magnitude = Curve("magnitude", hertz, 20.0 * np.log10(size), low, high)
        panels = [
            Panel("magnitude", "frequency [Hz]", axis("magnitude", "dB"), [magnitude], "log"),
            Panel(
                "phase",
                "frequency [Hz]",
                axis("phase", "°"),
                [Curve("phase", hertz, phase, phase - turn, phase + turn)],
                "log",
            ),
        ]
        return figure(Picture(panels))

    def step(self, duration: float | None = None) -> plotly.graph_objects.Figure:
        """The response to a unit step at t = 0 with its 95 % band, as a Plotly figure.

        Parameters
        ----------
        duration : float
            [s]; None: as long as the impulse response.

        Returns
        -------
        plotly.graph_objects.Figure

        Raises
        ------
        MissingPackage
            Plotly is not installed.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> len(plant.step(10.0).data) > 0
        True
        """
        model = self.identified
        n = (
            # As long as the impulse response: behind it a step's response stays where it is.
            model.delay + model.order
            if duration is None
            else max(2, round(duration / model.sample_time))
        )
        u = np.ones(n)
        # The response of the input alone: a level of the output is no part of it.
        y, spread = model.simulate(u) - model.offset, _BAND * model.simulation_std(u)
        time = model.sample_time * np.arange(n)
        title = f"step response, {model.input_name} → {model.output_name}"
        curve = Curve("step response", time, y, y - spread, y + spread)
        return figure(
            Picture([Panel(title, "time [s]", axis(model.output_name, gain_unit(model)), [curve])])
        )

    def _answer(self) -> dict[str, Any]:
        answer = identification_json(self.identified, self.method, self.estimation, self.held_out)
        assumed = None if self.assumptions is None else self.assumptions.to_dict()
        return answer | {
            "static_gain": static_gain(self.identified, assumed),
            "assumptions": assumed,
            "check": None if self.check is None else self.check.to_dict(),
        }

    def __str__(self) -> str:
        return self.report(self._answer())

    def report(self, answer: dict[str, Any]) -> str:
        """The short human report of an answer of `to_dict`, which may name the model's file.

        Parameters
        ----------
        answer : dict
            As `to_dict` gives it.

        Returns
        -------
        str

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", order=40)
        >>> plant.report(plant.to_dict()) == str(plant)
        True
        """
        text = identification_text(self.identified, answer)
        return text if self.check is None else "\n".join([text, *self.check.lines()])

    def _rows(self) -> Sequence[Row]:
        model = self.identified
        times = model.sample_time * (model.delay + np.arange(model.order))
        coefficients = zip(times, model.impulse_response, model.std, strict=True)
        return [
            {"time": float(t), "impulse_response": float(g), "std": float(s)}
            for t, g, s in coefficients
        ]

    def _picture(self) -> Picture:
        return Picture([response_panel(self.identified)])


@asks(Identify)
def identify(
    records: MeasuredRecord | str | PathLike[str] | Sequence[MeasuredRecord | str | PathLike[str]],
    *,
    progress: Progress = None,
    **given: Any,
) -> Plant | MultivariablePlant:
    """A linear model from one channel to another, or from several to several, with the covariance
    of its estimate.

    Parameters
    ----------
    records : Record, file, or a list of these
        Each is a separate experiment; a note `split: 0.7` keeps the rest of a record for
        validation.
    progress : callable or bool
        As in `Model.explain`.

    Returns
    -------
    Plant, or MultivariablePlant of several inputs or outputs
        Its warnings say when the record speaks of an integrator, feedback or a dead time that the
        model does not have, and when data kept aside (the last 30 % where no note splits the
        record) do not bear it out; no controller is designed then.

    Raises
    ------
    BadInput
        An unknown method, kernel or channel.
    NotIdentifiable
        Too few samples, an input that does not move.

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.simulate("process-plant", seed=1)
    >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
    >>> plant.identified.is_parametric
    True
    """
    asked = Identify.of(given)
    with progress_shown(progress) as tell:
        return identified(as_records(records), asked, tell)


def load_plant(path: str | PathLike[str]) -> Plant:
    """The plant in a file that `Plant.save` or `residuum identify --out` wrote.

    Parameters
    ----------
    path : str or path

    Returns
    -------
    Plant

    Raises
    ------
    BadModel
        No such file, or not the file of an identified model.

    Examples
    --------
    >>> import residuum as rs, tempfile, pathlib
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "plant.json"
    >>> plant.save(file)
    >>> rs.load_plant(file).impulse_response.shape
    (40,)
    """
    model = load_identified(Path(path))
    # A model's method says more than was asked for: kernel-tc, fir-elastic-net.
    asked = [name for name in METHODS if f"-{name}-" in f"-{model.method}-"]
    return Plant(model, max(asked, key=len, default=model.method))


def plant_of(given: Plant | str | PathLike[str]) -> Plant:
    """A plant, or the one in a file."""
    return given if isinstance(given, Plant) else load_plant(given)


def identified(
    records: Sequence[MeasuredRecord], asked: Identify, tell: Tell
) -> Plant | MultivariablePlant:
    """The plant that the method finds; each record's part after its split note is kept for
    validation.
    """
    estimation, held_out = split_records(records)
    tell(0.1, f"identifying from {sum(record.n for record in estimation)} samples")
    if asked.is_multivariable:
        return multivariable_plant(estimation, held_out, asked)
    plant = None
    # Before the fit: a method whose models are stable only must not be tried on an unstable plant.
    if asked.input is not None:
        plant = plant_tests(estimation, asked, asked.delay)
        check_stable(asked.method, plant, estimation[0].sample_time)
    # An error model is of data that the fit has not seen, where a split note keeps some.
    model = with_uncertainty(identified_by(estimation, asked), held_out or estimation, asked)
    if plant is None:
        return Plant(model, asked.method, estimation, held_out)
    tell(0.6, "testing what the model assumes")
    # With a split note the model is judged on what it kept; without, a fit of the first part is.
    parts = parts_kept_aside(model, asked, estimation, records)
    assumed = assumptions(model, asked, estimation, parts, plant)
    check = None
    if asked.check:
        tell(0.7, "testing residuals and drawing blocks")
        check = model_check(model, asked, parts, estimation)
    tell(0.9, "simulating beside the records")
    return Plant(
        with_remarks(model, asked.method, assumed, estimation),
        asked.method,
        estimation,
        held_out,
        assumed,
        check,
    )


def split_records(
    records: Sequence[MeasuredRecord],
) -> tuple[tuple[MeasuredRecord, ...], tuple[MeasuredRecord, ...]]:
    """What a model is identified from, and what the records' split notes keep for validation."""
    cuts = [
        # A record needs one sample, however small the share.
        record.n if record.split is None else max(1, round(record.split * record.n))
        for record in records
    ]
    estimation = tuple(record.window(0, cut) for record, cut in zip(records, cuts, strict=True))
    return estimation, tuple(
        record.window(cut, record.n)
        for record, cut in zip(records, cuts, strict=True)
        if cut < record.n
    )


def to_control(system: Any) -> Any:
    """A `TransferFunction` of ours as python-control's."""
    control = need("control", "to_control()")
    given = (system.num, system.den)
    return (
        control.tf(*given) if system.sample_time is None else control.tf(*given, system.sample_time)
    )
