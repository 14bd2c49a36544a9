"""What a reader must be told where a file does not say it itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from residuum.identification.errors import BadRecord


@dataclass(frozen=True)
class ReadOptions:
    """Settings of a reader.

    Parameters
    ----------
    resample : bool
        Accept uneven time stamps by linear interpolation onto even instants.
    sample_time : float or None
        Seconds between samples, for files that do not carry it; a file that does carry it wins
        nothing: a difference of more than 1 % is refused.
    units : mapping of channel name to unit
        For files that carry no units.
    decimal, time_form, time_column : str or None
        Of a logger's file, where its text leaves them open: the decimal sign, the form of its
        times, the name of their column.
    missing : sequence of str
        Of a logger's file: cells that mean no value, beside those that loggers write.
    names : sequence of str
        Of a logger's file without heads: those of all its columns, units in brackets.
    duplicates, reordered : str or None
        What becomes of a logger's rows of one stamp (`first`, `mean`, `spread`) and out of order
        (`sort`, `bridge`).
    """

    resample: bool = False
    sample_time: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    decimal: str | None = None
    time_form: str | None = None
    time_column: str | None = None
    missing: Sequence[str] = ()
    names: Sequence[str] = ()
    duplicates: str | None = None
    reordered: str | None = None

    def __post_init__(self) -> None:
        if self.sample_time is not None and not self.sample_time > 0:
            raise BadRecord(
                repr(self.sample_time), "sample_time", "must be a positive number of seconds"
            )

    def settle_sample_time(self, own_step: float | None, source: str) -> float:
        """The sample time [s] of file `source`: what it says, or what the caller says; both must
        agree.
        """
        if own_step is None and self.sample_time is None:
            raise BadRecord(
                f"{source}: does not say its sample time", way_on=[("sample_time", "SECONDS")]
            )
        if own_step is None or self.sample_time is None:
            return float(own_step if own_step is not None else self.sample_time or 0.0)
        # What differs by less is a rounded figure, and the file's own holds.
        if abs(own_step - self.sample_time) > 0.01 * own_step:
            raise BadRecord(
                f"{source}: has sample time {own_step:.6g} s, but {self.sample_time:.6g} s was"
                " given; leave it out"
            )
        return float(own_step)

    @property
    def of_a_logger(self) -> bool:
        """Whether something is said that only a logger's text leaves open."""
        return any(
            (
                self.decimal,
                self.time_form,
                self.time_column,
                self.missing,
                self.names,
                self.duplicates,
                self.reordered,
            )
        )

    def unit_of(self, name: str, own_unit: str = "") -> str:
        """The unit of channel `name`: what the caller says, else what the file says."""
        return self.units.get(name, own_unit)
