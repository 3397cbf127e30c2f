"""What stands still: sky, ground with a mown pattern that lets motion be read, fences and their shadows."""

from __future__ import annotations

import numpy as np

from echelon.export.light import SHADOW_COLOR, STANDING_SHADOWS, display_encoded, flattened, lit
from echelon.export.mesh_parts import separate_parts
from echelon.export.picture_source import COLUMNS_NAME, PEN_NAME, DrawnPen, DrawnWorld
from echelon.export.renderer import Surface, joined
from echelon.export.shapes import Mesh

SQUARE = 2.0  # [m], side of a mown square
SQUARE_LIMIT = 8000  # about so many squares in a picture, at most: on open ground the pattern fades out
PATTERN_REACH = 60.0  # [m] around the action

# Linear RGB.
GRASS = np.array([0.105, 0.235, 0.055])
MEADOW = np.array([0.130, 0.230, 0.072])  # outside the infield
TRACK = np.array([0.42, 0.30, 0.19])  # around the infield
MAT = np.array([0.055, 0.16, 0.34])
MAT_EDGE = np.array([0.62, 0.60, 0.55])
WATER = np.array([0.03, 0.20, 0.28])
CONCRETE = np.array([0.55, 0.56, 0.57])
PEN_FLOOR = np.array([0.36, 0.29, 0.15])
RAILS = np.array([0.80, 0.78, 0.72])
PEN_RAILS = np.array([0.52, 0.16, 0.06])
STONE = np.array([0.46, 0.44, 0.41])
HILLS = np.array([0.07, 0.15, 0.09])
HAZE = np.array([0.62, 0.72, 0.80])
ZENITH = np.array([0.20, 0.40, 0.75])

_MATERIALS = {PEN_NAME: PEN_RAILS, COLUMNS_NAME: STONE}
TRACK_WIDTH = 5.0  # [m]
MAT_SQUARE = 1.0  # [m], about, of the pieces that a mat is made of
MAT_MARGIN = 0.3  # [m], width of its edge
HORIZON = 1600.0  # [m]
_SEGMENTS = 96  # of rings far away
_UP = np.array([0.0, 0.0, 1.0], dtype=np.float32)


def scenery(world: DrawnWorld, low: np.ndarray, high: np.ndarray, origin: np.ndarray) -> list[Surface]:
    """Surfaces that do not move, transparent ones last.

    Args:
        world: Ground, fences and corral.
        low, high: Corners of the box in which the action is [m], shape [2] each.
        origin: What is to be the origin of the pictures' coordinates [m], shape [2].
    """
    middle = 0.5 * (low + high)
    # Each piece of ground ends where the next begins: hidden layers would cost the rasteriser as much as seen ones.
    if world.platform is not None:
        edge = _rectangle_outline(np.full(2, 60.0))
        solid = [_fan(np.concatenate([[[0.0, 0.0]], middle + edge]), 0.0, np.tile(WATER, (_SEGMENTS + 1, 1)))]
        solid.append(_matt(world.platform.mesh, CONCRETE))
    elif world.oval is not None:
        length, width = world.oval
        middle = np.zeros(2)
        infield, edge = (_oval_outline(length + wider, width + wider) for wider in (-0.1, TRACK_WIDTH))
        solid = [_mown(np.array([-length, -width]), np.array([length, width]), (length, width)), _track(infield, edge)]
    else:
        half = 0.5 * (high - low) + PATTERN_REACH
        half = half * min(1.0, float(np.sqrt(SQUARE_LIMIT * SQUARE**2 / (4.0 * half.prod()))))
        solid = [_mown(middle - half, middle + half, None)]
        edge = _rectangle_outline(half - SQUARE)
    if world.mat is not None:
        solid += _mat(np.asarray(world.mat))
    if world.pen is not None:
        solid.append(_pen_floor(world.pen))
    shadows = []
    for fence in world.fences:
        solid.append(_matt(fence.mesh, _MATERIALS.get(fence.name, RAILS)))
        shadows.append(_standing_shadow(fence.mesh))
    # Last what is behind everything: the depth test then spares the rasteriser most of it.
    ranges = [hills(middle, 500.0, 14.0, 0.45), hills(middle, 1000.0, 45.0, 0.7)]
    solid += [_far_ground(middle, edge), *ranges, sky(middle)]
    merged = [joined(solid), joined(shadows)] if shadows else [joined(solid)]
    shift = np.array([origin[0], origin[1], 0.0])
    return [
        Surface((surface.points - shift).astype(np.float32), surface.colors, surface.triangles) for surface in merged
    ]


# ---- ground and sky ------------------------------------------------------------------------------------------------
def _mown(low: np.ndarray, high: np.ndarray, oval: tuple[float, float] | None) -> Surface:
    """Squares of grass mown to and fro, lighter and darker, between two corners [m] or inside an oval there."""
    x_lines, y_lines = _lines(low[0], high[0]), _lines(low[1], high[1])
    if oval is not None:
        # Rows end on the outline; towards its sides, where it runs along them, more of them, or its chords would show.
        side = oval[1] * np.array([0.95, 0.975, 0.988, 0.996, 1.0])
        y_lines = np.unique(np.clip(np.concatenate([y_lines, side, -side]), -oval[1], oval[1]))
    columns, rows = len(x_lines) - 1, len(y_lines) - 1
    corners = np.empty((rows, columns, 4, 2))
    for corner, (x_step, y_step) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        corners[:, :, corner, 0] = x_lines[x_step : x_step + columns]
        corners[:, :, corner, 1] = y_lines[y_step : y_step + rows, None]
    # The pattern is tied to the world, not to the picture: whole squares from the world's origin.
    column = np.floor((x_lines[:-1] + x_lines[1:]) / (2.0 * SQUARE)).astype(np.int64)[None]
    row = np.floor((y_lines[:-1] + y_lines[1:]) / (2.0 * SQUARE)).astype(np.int64)[:, None]
    tone = 0.14 * (row % 2) + 0.07 * (column % 2) - 0.105 + 0.05 * (_scatter(column, row) - 0.5)
    if oval is None:
        tone = np.broadcast_to(tone, (rows, columns))[..., None] * _faded(corners, low, high)
    else:
        limit = oval[0] - oval[1] + np.sqrt(np.maximum(oval[1] ** 2 - corners[..., 1] ** 2, 0.0))
        corners[..., 0] = np.clip(corners[..., 0], -limit, limit)
        tone = np.broadcast_to(tone[..., None], (rows, columns, 4))
    points = np.zeros((rows * columns * 4, 3), dtype=np.float32)
    points[:, :2] = corners.reshape(-1, 2)
    base = GRASS if oval is not None else MEADOW
    first = 4 * np.arange(rows * columns)[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return Surface(points, _flat_colors(base * (1.0 + tone.reshape(-1, 1))), triangles)


def _lines(low: float, high: float) -> np.ndarray:
    """Multiples of `SQUARE` that enclose an interval [m]."""
    return SQUARE * np.arange(np.floor(low / SQUARE), np.ceil(high / SQUARE) + 1.0)


def _faded(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """1 in the middle of a field, 0 at its edge, for corners of squares [..., 2] [m]."""
    part = np.abs(corners - 0.5 * (low + high)) / (0.5 * (high - low))
    return np.clip((1.0 - part.max(axis=-1)) / 0.4, 0.0, 1.0)


def _scatter(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """A number from 0 to 1 for each square, the same in every picture."""
    mixed = (column * 73856093) ^ (row * 19349663)
    return ((mixed * 2654435761) % 4294967296) / 4294967296.0


def _track(inner: np.ndarray, outer: np.ndarray) -> Surface:
    """A band of trodden earth between two outlines about the origin [m]."""
    points = np.full((2 * _SEGMENTS, 3), -0.02, dtype=np.float32)
    points[:, :2] = np.concatenate([inner, outer])
    return Surface(points, _flat_colors(np.tile(TRACK, (len(points), 1))), _bands(1))


def _far_ground(middle: np.ndarray, edge: np.ndarray) -> Surface:
    """Meadow all round in patches, from an outline about the middle [m] to the horizon, where it turns into haze."""
    outward = np.array([-0.2, 12.0, 28.0, 50.0, 80.0, 130.0, 220.0, 400.0, 750.0, HORIZON])
    haze = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.04, 0.12, 0.35, 0.70, 1.0])
    rings = np.arange(len(outward))
    distance = np.linalg.norm(edge, axis=1, keepdims=True)
    points = np.zeros((len(outward), _SEGMENTS, 3), dtype=np.float32)
    points[..., :2] = middle + edge / distance * (distance + outward[:, None, None])
    points[..., 2] = -0.04
    tone = 0.16 * (_scatter(np.arange(_SEGMENTS)[None], rings[:, None]) - 0.5) * (1.0 - haze[:, None])
    near = lit(MEADOW * (1.0 + tone[..., None]), np.broadcast_to(_UP, points.shape))
    colors = near + haze[:, None, None] * (display_encoded(HAZE) - near)
    return Surface(points.reshape(-1, 3), _with_opacity(colors.reshape(-1, 3)), _bands(len(outward) - 1))


def hills(middle: np.ndarray, radius: float, height: float, haze: float) -> Surface:
    """A ring of hills far away: radius and mean height [m], and how much of their colour is lost in haze."""
    angle = 2.0 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    crest = height * (
        1.0 + 0.45 * np.sin(3.0 * angle + radius) + 0.3 * np.sin(7.0 * angle) + 0.2 * np.cos(11.0 * angle)
    )
    points = np.zeros((2, _SEGMENTS, 3), dtype=np.float32)
    points[..., :2] = middle + radius * _circle()
    points[1, :, 2] = crest
    points[0, :, 2] = -0.05
    color = display_encoded(HILLS + haze * (HAZE - HILLS))
    foot = color + 0.4 * (display_encoded(HAZE) - color)
    colors = np.repeat(np.stack([foot, color]), _SEGMENTS, axis=0)
    return Surface(points.reshape(-1, 3), _with_opacity(colors), _bands(1))


def sky(middle: np.ndarray) -> Surface:
    """Half a sphere around everything, from haze to blue."""
    elevation = np.radians([-3.0, 0.0, 4.0, 12.0, 30.0, 89.0])
    blue = np.array([0.0, 0.0, 0.18, 0.45, 0.8, 1.0])
    points = np.zeros((len(blue), _SEGMENTS, 3), dtype=np.float32)
    points[..., :2] = middle + HORIZON * np.cos(elevation)[:, None, None] * _circle()
    points[..., 2] = HORIZON * np.sin(elevation)[:, None]
    colors = display_encoded(HAZE + blue[:, None] * (ZENITH - HAZE))
    return Surface(points.reshape(-1, 3), _with_opacity(np.repeat(colors, _SEGMENTS, axis=0)), _bands(len(blue) - 1))


def _oval_outline(half_length: float, half_width: float) -> np.ndarray:
    """Where rays in the directions of `_circle` from the origin leave a stadium [m], shape [segments, 2]."""
    x, y = np.abs(_circle()).T
    straight = half_length - half_width
    along_side = half_width / np.maximum(y, 1e-12)
    along_bend = straight * x + np.sqrt(np.maximum(half_width**2 - (straight * y) ** 2, 0.0))
    return _circle() * np.where(along_side * x <= straight, along_side, along_bend)[:, None]


def _rectangle_outline(half: np.ndarray) -> np.ndarray:
    """Where rays in the directions of `_circle` from the origin leave a rectangle of half sizes [m]."""
    return _circle() * np.min(half / np.maximum(np.abs(_circle()), 1e-12), axis=1, keepdims=True)


def _circle() -> np.ndarray:
    """The unit circle in `_SEGMENTS` steps, counter-clockwise, shape [segments, 2]."""
    angle = 2.0 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _pen_floor(pen: DrawnPen) -> Surface:
    """Trodden ground inside the corral."""
    square = 0.5 * pen.size * np.array([[0.0, 0.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _fan(np.asarray(pen.center) + square, 0.0005, np.tile(PEN_FLOOR, (5, 1)))


def _mat(half: np.ndarray) -> list[Surface]:
    """A mat about the origin: its light edge, and pieces in two tones that let motion be read; half sizes [m]."""
    square = np.array([[0.0, 0.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    edge = _fan(square * half, 0.0004, np.tile(MAT_EDGE, (5, 1)))
    inside = np.maximum(half - MAT_MARGIN, 0.5 * half)
    counts = np.maximum(np.round(2.0 * inside / MAT_SQUARE), 1).astype(int)
    size = 2.0 * inside / counts
    column, row = (part.ravel() for part in np.meshgrid(np.arange(counts[0]), np.arange(counts[1]), indexing="ij"))
    tone = 1.0 + 0.1 * ((row + column) % 2) + 0.04 * _scatter(column, row)
    pieces = []
    for place, shade in zip(np.column_stack([column, row]), tone, strict=True):
        middle = -inside + (place + 0.5) * size
        pieces.append(_fan(middle + 0.5 * square * size, 0.0008, np.tile(MAT * shade, (5, 1))))
    return [edge, joined(pieces)]


def _fan(outline: np.ndarray, height: float, albedo: np.ndarray) -> Surface:
    """A flat shape from its middle, the first point, to a counter-clockwise outline [n, 2] [m]."""
    count = len(outline) - 1
    points = np.full((count + 1, 3), height, dtype=np.float32)
    points[:, :2] = outline
    here = np.arange(count)
    triangles = np.stack([np.zeros(count, np.int64), 1 + here, 1 + (here + 1) % count], axis=1)
    return Surface(points, _flat_colors(albedo), triangles)


def _bands(count: int) -> np.ndarray:
    """Triangles between rings of points: facing up where the rings grow outward, inward where they rise."""
    here, after = np.arange(_SEGMENTS), (np.arange(_SEGMENTS) + 1) % _SEGMENTS
    quads = []
    for ring in range(count):
        inner, outer = ring * _SEGMENTS, (ring + 1) * _SEGMENTS
        quads.append(np.stack([inner + here, outer + here, outer + after], axis=1))
        quads.append(np.stack([inner + here, outer + after, inner + after], axis=1))
    return np.concatenate(quads)


# ---- fences --------------------------------------------------------------------------------------------------------
def _matt(mesh: Mesh, albedo: np.ndarray) -> Surface:
    return Surface(mesh.points, _with_opacity(lit(albedo, mesh.normals)), mesh.triangles)


def _standing_shadow(mesh: Mesh) -> Surface:
    part = separate_parts(mesh)
    heights = STANDING_SHADOWS.heights(part, 1).astype(np.float32)
    colors = np.broadcast_to(SHADOW_COLOR, (len(mesh.points), 4))
    # Layers are drawn from the top down: the depth test lets only the first one darken.
    order = np.argsort(-heights[mesh.triangles[:, 0]], kind="stable")
    return Surface(flattened(mesh.points, heights), colors, mesh.triangles[order])


# ---- colours -------------------------------------------------------------------------------------------------------
def _flat_colors(albedo: np.ndarray) -> np.ndarray:
    """Colours of level ground of some albedo [n, 3]."""
    return _with_opacity(lit(albedo, np.broadcast_to(_UP, albedo.shape)))


def _with_opacity(colors: np.ndarray) -> np.ndarray:
    return np.concatenate([colors, np.ones((len(colors), 1))], axis=1).astype(np.float32)
