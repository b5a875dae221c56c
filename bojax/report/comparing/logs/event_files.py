"""Scalars in TensorBoard's event files: TFRecord files of messages `Event` of TensorFlow's protocol."""

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bojax.config.extras import MissingExtra
from bojax.report.comparing.logs.log import Columns, Logged, logged
from bojax.results.store import ResultsError

_HEADER = struct.Struct("<QI")  # length of a record, and a checksum of the length
_CHECKSUM = 4  # bytes after a record
_TYPES = {1: "<f4", 2: "<f8", 3: "<i4", 9: "<i8"}  # TensorFlow's numbers of the types of a scalar
_FIELDS = ("float_val", "double_val", "int_val", "int64_val")
_MODULES = ("tensorboardX.proto.event_pb2", "tensorboard.compat.proto.event_pb2")


def event_columns(folder: Path, files: Sequence[Path]) -> Columns:
    """The scalars of the event files of one folder, by tag; at least one.

    `MissingExtra` says that neither tensorboardX nor tensorboard is installed.
    """
    new_event = _event_class()
    points: dict[str, list[tuple[float, float]]] = {}
    scalar_tensors: set[str] = set()  # tags; only the first value of a tag says what it is
    for path in sorted(files):
        for record in _records(path):
            event = new_event()
            try:
                event.ParseFromString(record)
            except Exception as error:  # the class of protobuf's error depends on the package
                raise ResultsError(f"{path}: is damaged; allowed: an event file of TensorBoard") from error
            for value in event.summary.value:
                if value.metadata.plugin_data.plugin_name == "scalars":
                    scalar_tensors.add(value.tag)
                number = _scalar(value, is_scalar_tensor=value.tag in scalar_tensors)
                if number is not None:
                    points.setdefault(value.tag, []).append((event.step, number))
    if not points:
        raise ResultsError(f"{folder}: its event files have no scalars; allowed: a folder with scalars")

    def read(tag: str) -> Logged:
        steps, values = np.array(points[tag], dtype=np.float64).T
        return logged(f"{folder}: {tag}", steps, values)

    return {tag: partial(read, tag) for tag in points}


def _event_class() -> Callable[[], Any]:
    for module in _MODULES:
        try:
            return import_module(module).Event
        except ImportError:
            continue
    raise MissingExtra.of("tensorboardX", "tensorboard")


def _records(path: Path) -> Iterator[bytes]:
    """The records of a TFRecord file, without a last one that is still being written."""
    try:
        with path.open("rb") as file:
            is_first = True  # a writer completes its first record, the version, at once
            left = os.fstat(file.fileno()).st_size
            while len(header := file.read(_HEADER.size)) == _HEADER.size:
                length = _HEADER.unpack(header)[0] + _CHECKSUM
                left -= _HEADER.size + length
                if left < 0:
                    if is_first:
                        raise ResultsError(f"{path}: is damaged; allowed: an event file of TensorBoard")
                    return
                is_first = False
                yield file.read(length)[:-_CHECKSUM]
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read: {error.strerror or error}") from None


def _scalar(value: Any, *, is_scalar_tensor: bool) -> float | None:
    """The number of a value; None of an image, a histogram or text."""
    kind = value.WhichOneof("value")
    if kind == "simple_value":
        return value.simple_value
    if kind != "tensor" or not is_scalar_tensor:
        return None
    tensor = value.tensor
    if tensor.tensor_content and tensor.dtype in _TYPES:
        return float(np.frombuffer(tensor.tensor_content, _TYPES[tensor.dtype])[0])
    return next((float(found[0]) for name in _FIELDS if (found := getattr(tensor, name))), None)
