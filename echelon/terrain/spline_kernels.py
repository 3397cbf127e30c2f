"""A road's centreline as kernels see it: what is at an arc length, and what is closest to a point.

**Closest point.** An agent moves by less than a metre from frame to frame, so whoever remembers its s finds the new one
by walking over samples from there while they come nearer: O(1), and it stays on *its* stretch where another passes
close by or crosses. What starts with no memory looks at every eighth sample first.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

_COARSE = wp.constant(8)  # samples that a search without memory strides over
_FAR = wp.constant(1.0e15)  # [m], its square is a float32


@wp.struct
class CentrelineData:
    """A centreline as kernels see it, sampled at even steps of arc length.

    Attributes:
        positions: [m],                       shape [count + 1]; of a closed one the last is the first again
        tangents: Unit vectors along it,      shape [count + 1]
        curvatures: In plan, left positive [1/m], shape [count + 1]
        count: Steps.
        step: Arc length of a step [m].
        length: Arc length of it all [m].
        closed: 1 where the end is the start.
    """

    positions: wp.array[wp.vec3]
    tangents: wp.array[wp.vec3]
    curvatures: wp.array[wp.float32]
    count: wp.int32
    step: wp.float32
    length: wp.float32
    closed: wp.int32


@wp.func
def centreline_wrap(path: CentrelineData, s: float) -> float:
    """s within 0 and the length where the centreline is closed; as it is where it is open."""
    if path.closed == 0:
        return s
    inside = s - wp.floor(s / path.length) * path.length
    if inside >= path.length or inside < 0.0:  # rounding at the seam
        inside = 0.0
    return inside


@wp.func
def centreline_step(path: CentrelineData, s: float) -> int:
    """The step of the table that s lies in, the first or the last beyond the ends."""
    return wp.clamp(int(centreline_wrap(path, s) / path.step), 0, path.count - 1)


@wp.func
def centreline_part(path: CentrelineData, s: float, index: int) -> float:
    """How far into its step s lies, 0..1."""
    return wp.clamp(centreline_wrap(path, s) / path.step - float(index), 0.0, 1.0)


@wp.func
def centreline_local(path: CentrelineData, index: int, u: float) -> wp.vec3:
    """The cubic of a step relative to the sample it starts from [m]."""
    v = 1.0 - u
    run = path.positions[index + 1] - path.positions[index]
    bend = v * path.tangents[index] - u * path.tangents[index + 1]
    return u * u * (3.0 - 2.0 * u) * run + (u * v * path.step) * bend


@wp.func
def centreline_slope(path: CentrelineData, index: int, u: float) -> wp.vec3:
    """Derivative with respect to s within a step, of length one as closely as the table is fine.

    From the tangents: two samples, rounded to float32 some kilometres from the origin, give it 20 times less well.
    """
    return wp.lerp(path.tangents[index], path.tangents[index + 1], u)


@wp.func
def centreline_position(path: CentrelineData, s: float) -> wp.vec3:
    """Where the centreline is at arc length s [m]."""
    index = centreline_step(path, s)
    place = path.positions[index] + centreline_local(path, index, centreline_part(path, s, index))
    if path.closed == 0:
        if s < 0.0:
            place += s * path.tangents[0]
        if s > path.length:
            place += (s - path.length) * path.tangents[path.count]
    return place


@wp.func
def centreline_tangent(path: CentrelineData, s: float) -> wp.vec3:
    """Unit vector along the centreline in space."""
    index = centreline_step(path, s)
    return wp.normalize(centreline_slope(path, index, centreline_part(path, s, index)))


@wp.func
def centreline_grade(path: CentrelineData, s: float) -> float:
    """Rise over run."""
    along = centreline_tangent(path, s)
    return along[2] / wp.sqrt(along[0] * along[0] + along[1] * along[1])


@wp.func
def centreline_curvature(path: CentrelineData, s: float) -> float:
    """Curvature of the plan, positive where it bends left [1/m]."""
    if path.closed == 0 and (s < 0.0 or s > path.length):
        return 0.0
    index = centreline_step(path, s)
    return wp.lerp(path.curvatures[index], path.curvatures[index + 1], centreline_part(path, s, index))


@wp.func
def centreline_neighbour(path: CentrelineData, vertex: int, way: int) -> int:
    """The sample beside one: round the seam of a closed line, no farther than the ends of an open one."""
    other = vertex + way
    if path.closed == 0:
        return wp.clamp(other, 0, path.count)
    if other < 0:
        other += path.count
    if other >= path.count:
        other -= path.count
    return other


@wp.func
def centreline_gap(path: CentrelineData, vertex: int, point: wp.vec2) -> wp.vec2:
    """From a sample to a point on the map [m]."""
    sample = path.positions[vertex]
    return wp.vec2(point[0] - sample[0], point[1] - sample[1])


@wp.func
def centreline_refine(path: CentrelineData, point: wp.vec2, vertex: int) -> wp.vec2:
    """(s, offset) of the closest point of the cubic before or after the nearest sample."""
    index = vertex
    forward = path.tangents[vertex]
    if wp.dot(centreline_gap(path, vertex, point), wp.vec2(forward[0], forward[1])) < 0.0:
        index = centreline_neighbour(path, vertex, -1)
    index = wp.min(index, path.count - 1)

    gap = centreline_gap(path, index, point)
    run = path.positions[index + 1] - path.positions[index]
    chord = wp.vec2(run[0], run[1])
    u = wp.clamp(wp.dot(gap, chord) / wp.dot(chord, chord), 0.0, 1.0)
    for _ in range(2):
        local = centreline_local(path, index, u)
        slope = centreline_slope(path, index, u)
        first = wp.vec2(slope[0], slope[1])
        miss = wp.vec2(gap[0] - local[0], gap[1] - local[1])
        square = wp.dot(first, first)
        bend = wp.lerp(path.curvatures[index], path.curvatures[index + 1], u)
        # Newton with the curvature as the second derivative; inside a bend the slope of the function vanishes.
        left = (first[0] * miss[1] - first[1] * miss[0]) / wp.sqrt(square)
        part = wp.max(1.0 - bend * left, 0.5)
        u = wp.clamp(u + wp.dot(miss, first) / (square * part * path.step), 0.0, 1.0)

    local = centreline_local(path, index, u)
    slope = centreline_slope(path, index, u)
    miss = wp.vec2(gap[0] - local[0], gap[1] - local[1])
    square = slope[0] * slope[0] + slope[1] * slope[1]
    offset = (slope[0] * miss[1] - slope[1] * miss[0]) / wp.sqrt(square)
    s = (float(index) + u) * path.step
    if path.closed == 0:
        if (index == 0 and u == 0.0) or (index == path.count - 1 and u == 1.0):
            s += (miss[0] * slope[0] + miss[1] * slope[1]) / square
    elif s >= path.length:
        s -= path.length
    return wp.vec2(s, offset)


@wp.func
def centreline_closest(path: CentrelineData, point: wp.vec2, near_s: float) -> wp.vec2:
    """(s, offset) [m] of the closest point in plan, walked to from where it was before; the offset is left positive."""
    vertex = centreline_neighbour(path, centreline_step(path, near_s), 0)
    gap = centreline_gap(path, vertex, point)
    nearest = wp.dot(gap, gap)
    for side in range(2):
        way = 1 - 2 * side
        walking = wp.bool(True)
        while walking:
            ahead = centreline_neighbour(path, vertex, way)
            gap = centreline_gap(path, ahead, point)
            distance_sq = wp.dot(gap, gap)
            walking = distance_sq < nearest
            if walking:
                nearest = distance_sq
                vertex = ahead
    return centreline_refine(path, point, vertex)


@wp.func
def centreline_find(path: CentrelineData, point: wp.vec2) -> wp.vec2:
    """(s, offset) [m] of the closest point in plan of the whole centreline; the offset is left positive."""
    last = path.count - path.closed
    coarse = float(_FAR)
    vertex = wp.int32(0)
    while vertex <= last:
        coarse = wp.min(coarse, wp.length(centreline_gap(path, vertex, point)))
        vertex += _COARSE
    # A sample is at most half a stride from one that was looked at, or a whole one from the last.
    reach = coarse + float(_COARSE) * path.step
    nearest = float(_FAR)
    best = wp.int32(0)
    vertex = wp.int32(0)
    while vertex <= last:
        if wp.length(centreline_gap(path, vertex, point)) <= reach:
            for other in range(vertex, wp.min(vertex + _COARSE, last + 1)):
                distance = wp.length(centreline_gap(path, other, point))
                if distance < nearest:
                    nearest = distance
                    best = other
        vertex += _COARSE
    return centreline_refine(path, point, best)
