"""Sparkplug B payloads: metrics of a node or device, as protobuf bytes and back.

The message type is built here from field numbers of the Sparkplug specification 3.0 (section 6.4);
Google's protobuf does the bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

_Field = descriptor_pb2.FieldDescriptorProto
_ONE, _MANY = _Field.LABEL_OPTIONAL, _Field.LABEL_REPEATED
_U32, _U64, _TEXT, _BYTES = (
    _Field.TYPE_UINT32,
    _Field.TYPE_UINT64,
    _Field.TYPE_STRING,
    _Field.TYPE_BYTES,
)
_FLOAT, _DOUBLE, _BOOL, _MESSAGE = (
    _Field.TYPE_FLOAT,
    _Field.TYPE_DOUBLE,
    _Field.TYPE_BOOL,
    _Field.TYPE_MESSAGE,
)

_VALUES = {
    "int_value": _U32,
    "long_value": _U64,
    "float_value": _FLOAT,
    "double_value": _DOUBLE,
    "boolean_value": _BOOL,
    "string_value": _TEXT,
}
INT32, INT64, UINT64, DOUBLE, BOOLEAN, STRING = 3, 4, 8, 10, 11, 12
# Data types whose value travels as two's complement → its bits.
_SIGNED_BITS = {1: 8, 2: 16, 3: 32, 4: 64}
_QUALITY, _GOOD = "Quality", 192
# Properties in which senders give a unit; the specification names none.
_UNITS = ("engUnit", "EngUnit", "engineeringUnit", "Engineering Units", "unit", "Unit", "Units")


class BadPayload(Exception):
    """Bytes that are no Sparkplug B payload."""


@dataclass(frozen=True)
class Metric:
    """One value of a payload.

    Parameters
    ----------
    name : str
        Empty where the sender names it by its alias alone.
    value : float, int, bool, str or None
        None for a null, and for data sets, templates and bytes.
    datatype : int
        The specification's number (10 = Double); 0 where the sender leaves it to the birth.
    alias : int or None
    stamp : int or None
        Milliseconds since 1970.
    good : bool
        False where a property `Quality` says that it is not.
    unit : str
        What a property `engUnit` or `Unit` says.
    historical : bool
        Whether the sender kept it while it was not connected.
    """

    name: str
    value: Any
    datatype: int = 0
    alias: int | None = None
    stamp: int | None = None
    good: bool = True
    unit: str = ""
    historical: bool = False


@dataclass(frozen=True)
class Payload:
    """Metrics with the time of sending [ms since 1970] and the sequence number, where the message
    has one.
    """

    metrics: Sequence[Metric]
    stamp: int = 0
    seq: int | None = None


def number_of(metric: Metric, datatype: int = 0) -> float:
    """The metric's value as a number of its data type (the birth's where it has none of its own);
    nan for anything else.

    >>> number_of(Metric("a", 65535, datatype=2)), number_of(Metric("a", 65535, datatype=6))
    (-1.0, 65535.0)
    >>> number_of(Metric("a", "on"))
    nan
    """
    value = metric.value
    if not isinstance(value, int | float):
        return math.nan
    bits = _SIGNED_BITS.get(metric.datatype or datatype)
    if bits is None or not isinstance(value, int):
        return float(value)
    # some senders fill the bits above the type's own with the sign, others with zeros
    value &= (1 << bits) - 1
    return float(value - (1 << bits) if value >> (bits - 1) else value)


def unpack(content: bytes) -> Payload:
    """The payload of a message's bytes; BadPayload when they are none."""
    read: Any = _PAYLOAD()
    try:
        read.ParseFromString(content)
    except message.DecodeError as error:
        raise BadPayload(str(error)) from None
    metrics = [_metric(metric) for metric in read.metrics]
    return Payload(metrics, read.timestamp, read.seq if read.HasField("seq") else None)


def pack(payload: Payload) -> bytes:
    """The bytes of a payload."""
    encoded: Any = _PAYLOAD()
    encoded.timestamp = payload.stamp
    if payload.seq is not None:
        encoded.seq = payload.seq
    for metric in payload.metrics:
        _put(encoded.metrics.add(), metric)
    return bytes(encoded.SerializeToString())


def _put(encoded: Any, metric: Metric) -> None:
    """Write a metric; a field at its default is left out, as readers take one that is not there."""
    if metric.name:
        encoded.name = metric.name
    if metric.alias is not None:
        encoded.alias = metric.alias
    if metric.stamp is not None:
        encoded.timestamp = metric.stamp
    if metric.datatype:
        encoded.datatype = metric.datatype
    if metric.historical:
        encoded.is_historical = True
    if not metric.good:
        encoded.properties.keys.append(_QUALITY)
        encoded.properties.values.add(type=INT32, int_value=0)
    if metric.unit:
        encoded.properties.keys.append(_UNITS[0])
        encoded.properties.values.add(type=STRING, string_value=metric.unit)
    _put_value(encoded, metric.value)


def _put_value(encoded: Any, value: Any) -> None:
    # bool before int, of which it is one in Python
    if value is None:
        encoded.is_null = True
    elif isinstance(value, bool):
        encoded.boolean_value = value
    elif isinstance(value, str):
        encoded.string_value = value
    elif isinstance(value, int):
        encoded.long_value = value % (1 << 64)  # a negative one as two's complement
    else:
        encoded.double_value = value


def _metric(encoded: Any) -> Metric:
    held = encoded.WhichOneof("value")
    properties = dict(zip(encoded.properties.keys, encoded.properties.values, strict=False))
    return Metric(
        name=encoded.name,
        value=getattr(encoded, held) if held in _VALUES and not encoded.is_null else None,
        datatype=encoded.datatype,
        alias=encoded.alias if encoded.HasField("alias") else None,
        stamp=encoded.timestamp if encoded.HasField("timestamp") else None,
        good=_QUALITY not in properties or properties[_QUALITY].int_value == _GOOD,
        unit=next((properties[name].string_value for name in _UNITS if name in properties), ""),
        historical=encoded.is_historical,
    )


def _payload_type() -> Any:
    file = descriptor_pb2.FileDescriptorProto(
        name="residuum/sparkplug_b.proto", package="residuum.sparkplug", syntax="proto2"
    )
    payload = file.message_type.add(name="Payload")
    _add(payload, "timestamp", 1, _U64)
    _add(payload, "metrics", 2, _MESSAGE, _MANY, ".residuum.sparkplug.Metric")
    _add(payload, "seq", 3, _U64)
    metric = file.message_type.add(name="Metric")
    plain = (("name", _TEXT), ("alias", _U64), ("timestamp", _U64), ("datatype", _U32))
    for number, (name, kind) in enumerate(
        (*plain, *((f"is_{n}", _BOOL) for n in ("historical", "transient", "null"))), 1
    ):
        _add(metric, name, number, kind)
    _add(metric, "properties", 9, _MESSAGE, type_name=".residuum.sparkplug.PropertySet")
    _one_of(
        metric,
        10,
        (
            *_VALUES.items(),
            ("bytes_value", _BYTES),
            ("dataset_value", _BYTES),
            ("template_value", _BYTES),
        ),
    )
    properties = file.message_type.add(name="PropertySet")
    _add(properties, "keys", 1, _TEXT, _MANY)
    _add(properties, "values", 2, _MESSAGE, _MANY, ".residuum.sparkplug.PropertyValue")
    value = file.message_type.add(name="PropertyValue")
    _add(value, "type", 1, _U32)
    _add(value, "is_null", 2, _BOOL)
    _one_of(value, 3, _VALUES.items())
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("residuum.sparkplug.Payload"))


def _one_of(to: Any, first: int, fields: Iterable[tuple[str, Any]]) -> None:
    to.oneof_decl.add(name="value")
    for number, (name, kind) in enumerate(fields, first):
        _add(to, name, number, kind).oneof_index = 0


def _add(to: Any, name: str, number: int, kind: Any, label: Any = _ONE, type_name: str = "") -> Any:
    field = to.field.add(name=name, number=number, type=kind, label=label)
    if type_name:
        field.type_name = type_name
    return field


_PAYLOAD: Any = _payload_type()
