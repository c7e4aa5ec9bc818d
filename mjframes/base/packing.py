"""Frozen dataclasses as flat dictionaries of arrays, and back by their annotations: what an .npz holds of them.

A field of a field is "outer.inner". Of an array the type on disk is its own, for integers the smallest that holds them,
or the field's metadata "kept"; the annotation's when it is restored. Ragged tuples lie end to end, sparse matrices by
rows, dictionaries as JSON; None is left out. Metadata "symmetric" keeps lower triangles only.
"""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

T = TypeVar("T")
Arrays = dict[str, NDArray[Any]]
CONCRETE = (np.int64, np.int32, np.float64, np.float32)  # types that annotations name; others are of many
ROW_PARTS = ("data", "indices", "indptr", "columns")
NO_HINTS: Mapping[str, Any] = types.MappingProxyType({})


def packed(value: object, name: str = "", hints: Mapping[str, Any] = NO_HINTS, *, exact: bool = False) -> Arrays:
    """Return the arrays of a dataclass, or of one of its fields.  name: of the field.  hints: its metadata.

    exact: to the last bit and in the same types, whatever the hints say.
    """
    small = (lambda array: array) if exact else _smallest
    if value is None:
        return {}
    if isinstance(value, sparse.csr_array):
        data = value.data.astype(hints.get("kept", value.dtype), copy=False)
        parts = (data, value.indices, value.indptr, value.shape[1])  # pyright: ignore[reportOptionalSubscript]
        return {f"{name}.{part}": small(np.asarray(some)) for part, some in zip(ROW_PARTS, parts, strict=True)}
    if isinstance(value, np.ndarray):
        return {name: small(value.astype(hints.get("kept", value.dtype), copy=False))}
    if isinstance(value, tuple) and (not value or isinstance(value[0], np.ndarray)):
        parts = [lower_triangle(part) for part in value] if hints.get("symmetric") else value
        shapes = np.array([part.shape for part in parts]) if parts else np.zeros((0, 1))
        values = np.concatenate([np.ravel(part) for part in parts]) if parts else np.zeros(0)
        return {name: small(values), f"{name}.shape": _smallest(shapes.astype(np.int64))}
    if isinstance(value, Mapping):
        return {name: np.array(json.dumps({key: asdict(some) for key, some in value.items()}))}
    if is_dataclass(value):
        found: Arrays = {}
        for field in fields(value):
            inner = _inner(name, field.name)
            found |= packed(getattr(value, field.name), inner, NO_HINTS if exact else field.metadata, exact=exact)
        return found
    return {name: np.array(value)}


def restored(kind: type[T], arrays: Mapping[str, NDArray[Any]], name: str = "", *, exact: bool = False) -> T:
    """Return the dataclass `kind` that was packed.  exact: as it was packed.

    Raise ArithmeticError, AttributeError, LookupError, RecursionError, TypeError or ValueError for arrays that are not
    of its fields; whether they fit each other is not looked at.
    """
    hints = get_type_hints(kind)
    return kind(
        **{
            field.name: _restored(
                hints[field.name], arrays, _inner(name, field.name), NO_HINTS if exact else field.metadata, exact
            )
            for field in fields(cast(Any, kind))
        }
    )


def _restored(kind: Any, arrays: Mapping[str, NDArray[Any]], name: str, hints: Mapping[str, Any], exact: bool) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):  # of something and None
        if not any(key == name or key.startswith(f"{name}.") for key in arrays):
            return None
        return _restored(arguments[0], arrays, name, hints, exact)
    if kind is sparse.csr_array:
        *entries, columns = (arrays[f"{name}.{part}"] for part in ROW_PARTS)
        if not exact:
            entries = [_cast(*some, name) for some in zip(entries, (np.float64, np.int32, np.int64), strict=True)]
        return sparse.csr_array(tuple(entries), shape=(len(entries[2]) - 1, int(columns)))
    if is_dataclass(kind):
        return restored(cast(type, kind), arrays, name, exact=exact)
    array = arrays[name]
    if kind is np.ndarray or origin is np.ndarray:
        return array if exact else _cast(array, _dtype(kind, array), name)
    if origin is tuple and _is_array(arguments[0]):
        shapes, symmetric = _cast(arrays[f"{name}.shape"], np.int64, name), bool(hints.get("symmetric"))
        values = array if exact else _cast(array, _dtype(arguments[0], array), name)
        parts = np.split(values, np.cumsum(shapes.prod(axis=1))[:-1])
        if symmetric:
            return tuple(symmetric_matrix(part) for part in parts[: len(shapes)])
        return tuple(part.reshape(shape) for part, shape in zip(parts, shapes.tolist(), strict=False))
    if kind is str and array.dtype.kind != "U":
        raise ValueError(f"{name} is of type {array.dtype}")
    if origin is tuple:
        if array.ndim != 1 or (arguments[0] is str and array.size and array.dtype.kind != "U"):
            raise ValueError(f"{name} is of type {array.dtype} and shape {array.shape}")
        if arguments[-1] is not Ellipsis and len(array) != len(arguments):
            raise ValueError(f"{name} has {len(array)} values")
        return tuple(arguments[0](some) for some in array.tolist())
    if origin in (dict, Mapping):
        return {arguments[0](key): _from_json(arguments[1], some) for key, some in json.loads(str(array)).items()}
    return kind(array.item())


def lower_triangle(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lower triangle (n (n + 1) / 2,) of a symmetric (n, n) matrix, row by row."""
    return matrix[np.tril_indices(len(matrix))]


def symmetric_matrix(lower: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric (n, n) matrix of a lower triangle. Raise ValueError for a length that none has."""
    n = int(np.sqrt(2 * len(lower)))
    matrix = np.zeros((n, n))
    rows, columns = np.tril_indices(n)
    matrix[rows, columns] = lower
    matrix[columns, rows] = lower
    return matrix


def triangles(values: NDArray[np.float64], size: NDArray[np.integer]) -> tuple[NDArray[np.float64], ...]:
    """Return the symmetric matrices of some sizes whose lower triangles lie end to end in `values`; none for none."""
    if not len(values):
        return ()
    return tuple(map(symmetric_matrix, np.split(values, np.cumsum(size * (size + 1) // 2)[:-1])))


def _inner(outer: str, name: str) -> str:
    return f"{outer}.{name}" if outer else name


def _smallest(array: NDArray[Any]) -> NDArray[Any]:
    """Integers in the smallest type that holds them."""
    if not np.issubdtype(array.dtype, np.integer) or not array.size:
        return array
    return array.astype(np.promote_types(np.min_scalar_type(array.min()), np.min_scalar_type(array.max())))


def _is_array(kind: Any) -> bool:
    return kind is np.ndarray or get_origin(kind) is np.ndarray


def _dtype(kind: Any, array: NDArray[Any]) -> Any:
    """The scalar type that an annotation names; else wide integers, and the array's own."""
    named = get_args(get_args(kind)[1])[0] if get_origin(kind) is np.ndarray else None
    if isinstance(named, type) and issubclass(named, np.generic):
        return named if named in CONCRETE else array.dtype
    return np.int64 if np.issubdtype(array.dtype, np.integer) else array.dtype


def _cast(array: NDArray[Any], dtype: Any, name: str) -> NDArray[Any]:
    """An array of a type; of numbers only, and of whole ones where the type is."""
    kinds = "iu" if np.issubdtype(dtype, np.integer) else "fiu"
    if array.dtype.kind not in kinds:
        raise ValueError(f"{name} is of type {array.dtype}")
    return array.astype(dtype)


def _from_json(kind: Any, values: Mapping[str, Any]) -> Any:
    return kind(**{key: tuple(some) if isinstance(some, list) else some for key, some in values.items()})
