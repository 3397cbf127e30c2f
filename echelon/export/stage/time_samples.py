"""Authoring many time samples fast, straight into a layer.

`Usd.Attribute.Set` resolves an edit target for every value; a crowd has a million of them. Here attributes are written
as Sdf specs, values go from NumPy to Vt arrays in one copy, and a sample is authored only where it is needed: a value
that equals its neighbours in time says nothing. Call these inside one `Sdf.ChangeBlock`.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Sdf, Vt


@dataclass(frozen=True)
class Timing:
    """How rows of values become time samples.

    Attributes:
        first_frame: Time code of the first row.
        in_clip: The layer is a value clip: nothing but samples counts there, so there is one at least of every
            attribute, and no default.
    """

    first_frame: int = 0
    in_clip: bool = False


WHOLE = Timing()


def changes(values: np.ndarray) -> np.ndarray:
    """Frames at which a value that is *held* between samples must be authored: the first, and wherever it is new.

    Args:
        values: Values along the frames, shape [frames, ...].
    """
    return np.concatenate([[0], 1 + np.flatnonzero(_differs(values))]).astype(int)


def bends(values: np.ndarray) -> np.ndarray:
    """Frames at which a value that is *interpolated* between samples must be authored: all but the middle of a rest.

    Args:
        values: Values along the frames, shape [frames, ...].
    """
    differs = _differs(values)
    if not differs.any():
        return np.zeros(1, dtype=int)
    wanted = np.zeros(len(values), dtype=bool)
    wanted[0] = True
    wanted[1:] |= differs
    wanted[:-1] |= differs
    return np.flatnonzero(wanted)


def define(parent: Sdf.PrimSpec, name: str, type_name: str, timing: Timing = WHOLE) -> Sdf.PrimSpec:
    """A new prim; in a clip, which defines nothing, a place for samples only."""
    if timing.in_clip:
        return Sdf.PrimSpec(parent, name, Sdf.SpecifierOver)
    return Sdf.PrimSpec(parent, name, Sdf.SpecifierDef, type_name)


def author(
    prim: Sdf.PrimSpec,
    name: str,
    type_name: Sdf.ValueTypeName,
    values: Iterable[Any],
    frames: np.ndarray,
    *,
    interpolation: str | None = None,
    timing: Timing = WHOLE,
) -> Sdf.AttributeSpec:
    """Author an attribute whose default is the first value, with a time sample a frame if it has more than one.

    Args:
        prim: Where.
        name: Name of the attribute.
        type_name: Its type.
        values: One value for each of ``frames``.
        frames: Rows that the values are of, which are time codes but for ``timing``.
        interpolation: Of a primvar, such as ``constant``.
        timing: How rows become time samples.
    """
    spec = Sdf.AttributeSpec(prim, name, type_name)
    if interpolation is not None:
        spec.SetInfo("interpolation", interpolation)
    codes = (frames + timing.first_frame).astype(float).tolist()
    source = iter(values)
    first = next(source)
    if not timing.in_clip:
        spec.default = first
    if len(codes) > 1 or timing.in_clip:
        set_sample, path = prim.layer.SetTimeSample, spec.path
        set_sample(path, codes[0], first)
        for code, value in zip(codes[1:], source, strict=True):
            set_sample(path, code, value)
    return spec


def author_translations(prim: Sdf.PrimSpec, translations: np.ndarray, timing: Timing = WHOLE) -> None:
    """Author ``xformOp:translate`` from positions [m], shape [frames, 3]."""
    frames = bends(translations)
    values = Vt.Vec3dArray.FromNumpy(np.ascontiguousarray(translations[frames], dtype=np.float64))
    author(prim, "xformOp:translate", Sdf.ValueTypeNames.Double3, values, frames, timing=timing)


def author_orientations(prim: Sdf.PrimSpec, orientations: np.ndarray, timing: Timing = WHOLE) -> None:
    """Author ``xformOp:orient`` from quaternions (x, y, z, w), shape [frames, 4]."""
    single = np.ascontiguousarray(orientations, dtype=np.float32)
    frames = bends(single)
    values = Vt.QuatfArray.FromNumpy(single[frames])
    author(prim, "xformOp:orient", Sdf.ValueTypeNames.Quatf, values, frames, timing=timing)


def author_op_order(prim: Sdf.PrimSpec, ops: Sequence[str]) -> None:
    """Author ``xformOpOrder``."""
    spec = Sdf.AttributeSpec(prim, "xformOpOrder", Sdf.ValueTypeNames.TokenArray, Sdf.VariabilityUniform)
    spec.default = Vt.TokenArray(list(ops))


def author_constant(
    prim: Sdf.PrimSpec,
    name: str,
    type_name: Sdf.ValueTypeName,
    value: Any,
    *,
    uniform: bool = False,
    interpolation: str | None = None,
) -> None:
    """Author an attribute that does not change."""
    variability = Sdf.VariabilityUniform if uniform else Sdf.VariabilityVarying
    spec = Sdf.AttributeSpec(prim, name, type_name, variability)
    spec.default = value
    if interpolation is not None:
        spec.SetInfo("interpolation", interpolation)


def _differs(values: np.ndarray) -> np.ndarray:
    """Whether each frame from the second on differs from the one before, bool [frames - 1]."""
    rows = values.reshape(len(values), -1) if values.size else values.reshape(len(values), 0)
    return (rows[1:] != rows[:-1]).any(axis=1)
