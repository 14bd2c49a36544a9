"""One instance of an FMU, which begins a simulation as often as it is wanted and is never loaded
again.
"""

from __future__ import annotations

import ctypes
import hashlib
import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from threading import Lock, RLock
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel, in_one_line
from residuum.identification.physics.fmu.description import Description, fmpy

TOLERANCE = 1e-8
"""Relative tolerance that a solver of its own is asked for."""
# Event iterations at the start, at most: an FMU that always asks for one more would never begin.
_SETTLINGS = 10


_MADE: dict[tuple[str, bool], Instance] = {}
_MAKING = Lock()


def content_digest(path: str | Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def instance_of(description: Description) -> Instance:
    """The one instance in this process of the FMU with this content, wherever its file lies."""
    # An FMU that cannot be simulated by itself is exchanged, whatever else it lacks.
    exchanged = description.is_exchangeable or description.simulation is None
    key = content_digest(description.path), exchanged
    # Compiled code calls the instance that it was linked to: a second one would never be asked.
    with _MAKING:
        if key not in _MADE:
            _MADE[key] = Instance(description, exchanged=exchanged)
        return _MADE[key]


class Instance:
    """An FMU in this process, for model exchange or co-simulation.

    A simulation begins at the instance as it was made: by its state, kept then, where the FMU can
    bring one back, else by its reset. Both cost microseconds; loading costs as much as thousands of
    steps.

    Raises
    ------
    BadModel
        It cannot be set up with the start values of its description.
    """

    def __init__(self, description: Description, *, exchanged: bool) -> None:
        self.description = description
        self.exchanged = exchanged
        # One object with a state of its own: whoever settles it and simulates holds this meanwhile.
        self.lock = RLock()
        self.begun: object = None
        """Who began it last, and with what."""
        way = description.exchange if exchanged else description.simulation
        if way is None:
            asked = "model exchange" if exchanged else "co-simulation"
            raise BadModel(f"model {description.path!r}: the FMU does not offer {asked}")
        place = Path(tempfile.mkdtemp(prefix="residuum-fmu-"))
        weakref.finalize(self, shutil.rmtree, place, ignore_errors=True)
        # A copy: what a baseline holds is what was loaded, whatever becomes of the user's file.
        self.file = Path(shutil.copyfile(description.path, place / "loaded.fmu"))
        self.content = content_digest(self.file)
        self.folder = fmpy().extract(str(self.file), str(place / "extracted"))
        kind = f"FMU{description.version}{'Model' if exchanged else 'Slave'}"
        try:
            made = getattr(import_module(f"fmpy.fmi{description.version}"), kind)
            self.fmu: Any = made(
                guid=description.guid,
                unzipDirectory=self.folder,
                modelIdentifier=way.identifier,
                instanceName="residuum",
            )
            self.fmu.instantiate()
            # The state as it was made: bringing it back costs microseconds, loading as much as
            # thousands of steps.
            self._first: Any = self._kept() if way.keeps_state else None
            self._begin({}, ())
        except Exception as error:
            raise BadModel(
                f"model {description.path!r}: the FMU cannot be set up ({in_one_line(error)})"
            ) from None

    @property
    def component(self) -> int:
        """Its address."""
        component = self.fmu.component
        return int(getattr(component, "value", component) or 0)

    def begin(self, values: Mapping[str, float], inputs: Sequence[float] = ()) -> bool:
        """Begin a simulation at time 0 with these parameters and first inputs; False where the FMU
        refuses them.
        """
        self.begun = None
        try:
            self.afresh()
            self._begin(values, inputs)
        except Exception:
            # fmpy raises for any status that is an error: no machine has these parameters
            return False
        return True

    def _kept(self) -> Any:
        """Its state now; None where it cannot be had after all."""
        try:
            return self.fmu.getFMUState()
        except Exception:
            return None

    def afresh(self) -> None:
        """As it was made, for who begins a simulation himself."""
        if self._first is None:
            self.fmu.reset()
        else:
            self.fmu.setFMUState(self._first)

    def reals(self, references: Sequence[int]) -> list[float]:
        """Values of real variables."""
        if not references:
            return []
        two = self.description.version == 2
        return list(self.fmu.getReal(references) if two else self.fmu.getFloat64(references))

    def _set(self, references: Sequence[int], values: Sequence[float]) -> None:
        if references:
            two = self.description.version == 2
            (self.fmu.setReal if two else self.fmu.setFloat64)(references, values)

    def _begin(self, values: Mapping[str, float], inputs: Sequence[float]) -> None:
        fmu = self.fmu
        parameters = self.description.parameters
        self._set([parameters[name].reference for name in values], list(values.values()))
        # In model exchange the solver is ours: nothing to ask for.
        tolerance = None if self.exchanged else TOLERANCE
        if self.description.version == 2:
            fmu.setupExperiment(tolerance=tolerance, startTime=0.0)
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(tolerance=tolerance, startTime=0.0)
        # Within initialisation: an FMU may compute its first states from its inputs.
        self._set([v.reference for v in self.description.inputs[: len(inputs)]], list(inputs))
        fmu.exitInitializationMode()
        if self.exchanged:
            self._settle()

    def _settle(self) -> None:
        two = self.description.version == 2
        for _ in range(_SETTLINGS):
            needed, *_ = self.fmu.newDiscreteStates() if two else self.fmu.updateDiscreteStates()
            if not needed:
                break
        self.fmu.enterContinuousTimeMode()

    def place(self, point: FloatArray) -> None:
        """Bring it to these states and inputs, of model exchange."""
        nx = len(self.description.states)
        x = np.ascontiguousarray(point[:nx], dtype=np.float64)
        self.fmu.setTime(0.0)
        if nx:
            self.fmu.setContinuousStates(x.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), nx)
        self._set([v.reference for v in self.description.inputs], point[nx:].tolist())

    def answer(self) -> FloatArray:
        """Rates, then outputs, where it is."""
        nx = len(self.description.states)
        rates = np.zeros(nx)
        pointer = rates.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        if nx and self.description.version == 2:
            self.fmu.getDerivatives(pointer, nx)
        elif nx:
            self.fmu.getContinuousStateDerivatives(pointer, nx)
        outputs = self.reals([v.reference for v in self.description.outputs])
        return np.concatenate([rates, outputs])

    def derivative(self, reference: int) -> FloatArray:
        """Directional derivative of rates and outputs by one variable, where it is."""
        described = self.description
        unknown = [v.reference for v in (*described.derivatives, *described.outputs)]
        return np.array(self.fmu.getDirectionalDerivative(unknown, [reference], [1.0]))

    def function(self, name: str, *types: Any) -> Any:
        """One of the library's functions, `SetTime`, for compiled code."""
        full = f"fmi{self.description.version}{name}"
        return ctypes.CFUNCTYPE(ctypes.c_int, *types)((full, self.fmu.dll))
