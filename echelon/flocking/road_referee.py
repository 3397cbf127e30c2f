"""The road's referee: how far each rider has come, who has left the road, who has touched whom or what, who is there.

A body is a capsule on the ground along its bicycle, from behind the rear wheel to ahead of the front wheel. Two whose
capsules overlap have collided; that is reported once, when they begin to, by the one of lower index. A rider is off the
road while a wheel is beyond its edge. Whole numbers are added up as such and each rider's sums by that rider alone, so
that nothing depends on how riders are dealt to threads.
"""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import warp as wp

from echelon.flocking.referee import PARTNER_LIMIT, enter_partner
from echelon.flocking.road_obstacles import RoadObstacles
from echelon.flocking.road_riders import ABSENT, UNFINISHED, RoadRiders, RoadRules, left_of, level_tangent, line_gap
from echelon.terrain.spline_kernels import CentrelineData, centreline_curvature
from echelon.warp_kernels.atomics import atomic_increase
from echelon.warp_kernels.neighbours import NOBODY, CellTable, cell_entry, is_somewhere
from echelon.warp_kernels.replay import Phase, Share

wp.set_module_options({"enable_backward": False})

ROAD_TOTALS = ("off_road", "collisions", "struck", "finished")
OFF_ROAD = wp.constant(0)  # how often somebody has left the road
COLLISIONS = wp.constant(1)  # how many collisions have begun
STRUCK = wp.constant(2)  # how often somebody has run into an obstacle
FINISHED = wp.constant(3)  # how many have ridden the whole distance, the user aside


@dataclass(frozen=True)
class RoadRefereeArrays:
    """What the referee has seen until the frame looked at last; arrays of shape [riders], the user last.

    Attributes:
        totals: See `ROAD_TOTALS`; of all frames so far, shape [4].
        progress: Along the road, on and on over laps, from the start line [m], float64.
        distance: Ridden by the rear wheel [m], float64.
        off_road: 1 while a wheel is beyond the road's edge.
        off_road_count: How often that has begun.
        struck: 1 while a body touches an obstacle.
        struck_count: How often that has begun.
        begun: How many collisions with riders of higher index have begun in this frame.
        partners: Their indices, as many as there are, ascending, shape [riders, PARTNER_LIMIT].
        collisions: How many collisions of each have begun so far, with anybody of higher index.
        finish_frame: In which the whole distance had been ridden; `UNFINISHED` until then.
        shelter_sum: Of shelter over frames, float64.
        frames: How many have been looked at, shape [1].
        previous: Place in the frame before [m].
        previous_heading: Unit vector.
    """

    totals: wp.array[wp.int32]
    progress: wp.array[wp.float64]
    distance: wp.array[wp.float64]
    off_road: wp.array[wp.int32]
    off_road_count: wp.array[wp.int32]
    struck: wp.array[wp.int32]
    struck_count: wp.array[wp.int32]
    begun: wp.array[wp.int32]
    partners: wp.array2d[wp.int32]
    collisions: wp.array[wp.int32]
    finish_frame: wp.array[wp.int32]
    shelter_sum: wp.array[wp.float64]
    frames: wp.array[wp.int32]
    previous: wp.array[wp.vec2]
    previous_heading: wp.array[wp.vec2]


# ---- bodies ----------------------------------------------------------------------------------------------------------
@wp.func
def from_segment(point: wp.vec2, a: wp.vec2, b: wp.vec2) -> float:
    """Distance from a point to a segment [m]."""
    along = b - a
    part = wp.clamp(wp.dot(point - a, along) / wp.max(wp.dot(along, along), 1.0e-12), 0.0, 1.0)
    return wp.length(point - a - part * along)


@wp.func
def side_of(point: wp.vec2, a: wp.vec2, b: wp.vec2) -> float:
    """Positive where a point is to the left of the line from a to b."""
    return wp.dot(left_of(b - a), point - a)


@wp.func
def bodies_overlap(a: wp.vec2, along_a: wp.vec2, b: wp.vec2, along_b: wp.vec2, rules: RoadRules) -> bool:
    """Whether two bodies overlap, given rear contacts [m] and directions; never where a number is not one."""
    radius = rules.body_half_width
    back = radius - rules.body_behind
    front = rules.body_length - rules.body_behind - radius
    a0 = a + back * along_a
    a1 = a + front * along_a
    b0 = b + back * along_b
    b1 = b + front * along_b
    if side_of(a0, b0, b1) * side_of(a1, b0, b1) < 0.0 and side_of(b0, a0, a1) * side_of(b1, a0, a1) < 0.0:
        return True
    nearest = wp.min(
        wp.min(from_segment(a0, b0, b1), from_segment(a1, b0, b1)),
        wp.min(from_segment(b0, a0, a1), from_segment(b1, a0, a1)),
    )
    return nearest < 2.0 * radius


@wp.func
def touches_obstacle(
    rider: int, rules: RoadRules, path: CentrelineData, riders: RoadRiders, obstacles: RoadObstacles
) -> bool:
    """Whether a body touches an obstacle, both in the road's terms."""
    s = riders.s[rider]
    offset = riders.offset[rider]
    tangent = level_tangent(path, s)
    ahead = wp.dot(riders.heading[rider], tangent)
    aside = wp.dot(riders.heading[rider], left_of(tangent))
    radius = rules.body_half_width
    back = radius - rules.body_behind
    front = rules.body_length - rules.body_behind - radius
    for k in range(obstacles.start.shape[0]):
        gap = line_gap(path, s, offset, obstacles.s[k])
        if wp.abs(gap) < obstacles.half_length[k] + rules.body_length:
            for point in range(5):
                along = wp.lerp(back, front, 0.25 * float(point))
                beyond = wp.abs(gap - along * ahead) - obstacles.half_length[k]
                across = offset + along * aside
                beside = wp.max(obstacles.low[k] - across, across - obstacles.high[k])
                if wp.length(wp.vec2(wp.max(beyond, 0.0), wp.max(beside, 0.0))) < radius:
                    return True
    return False


# ---- looking ---------------------------------------------------------------------------------------------------------
@wp.kernel
def time_riders(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    finish: wp.float64,
    # state in
    frame_in: wp.array[wp.int32],
    riders: RoadRiders,
    # state in and out
    totals: wp.array[wp.int32],
    progress: wp.array[wp.float64],
    finish_frame: wp.array[wp.int32],
):
    """How far each rider has come, and who is there: for everybody, since the run may end with it."""
    rider = first + wp.tid()
    if riders.presence[rider] == ABSENT:
        return
    progress[rider] = wp.float64(riders.s[rider]) + wp.float64(riders.laps[rider]) * wp.float64(path.length)
    if finish_frame[rider] == UNFINISHED and progress[rider] >= finish:
        finish_frame[rider] = frame_in[0]
        if rider != rules.first_user:
            atomic_increase(totals, FINISHED, 1)


@wp.kernel
def judge(
    first: int,
    # model
    rules: RoadRules,
    path: CentrelineData,
    # state in
    frames_in: wp.array[wp.int32],
    table: CellTable,
    riders: RoadRiders,
    obstacles: RoadObstacles,
    previous_in: wp.array[wp.vec2],
    previous_heading_in: wp.array[wp.vec2],
    # state in and out
    totals: wp.array[wp.int32],
    distance: wp.array[wp.float64],
    off_road: wp.array[wp.int32],
    off_road_count: wp.array[wp.int32],
    struck: wp.array[wp.int32],
    struck_count: wp.array[wp.int32],
    collisions: wp.array[wp.int32],
    shelter_sum: wp.array[wp.float64],
    # out
    begun_out: wp.array[wp.int32],
    partners_out: wp.array2d[wp.int32],
):
    """Look at one rider."""
    rider = first + wp.tid()
    begun_out[rider] = 0
    if riders.presence[rider] == ABSENT:
        return
    place = table.places[rider]
    heading = riders.heading[rider]
    begins = frames_in[0] == 0

    if not begins and is_somewhere(previous_in[rider]):
        distance[rider] = distance[rider] + wp.float64(wp.length(place - previous_in[rider]))
    shelter_sum[rider] = shelter_sum[rider] + wp.float64(riders.shelter[rider])

    tangent = level_tangent(path, riders.s[rider])
    reach = rules.wheelbase * wp.dot(heading, tangent)
    turned = rules.wheelbase * wp.dot(heading, left_of(tangent))
    front = riders.offset[rider] + turned - 0.5 * centreline_curvature(path, riders.s[rider]) * reach * reach
    is_off = wp.where(wp.max(wp.abs(riders.offset[rider]), wp.abs(front)) > rules.half_width, 1, 0)
    if is_off == 1 and off_road[rider] == 0:
        off_road_count[rider] = off_road_count[rider] + 1
        atomic_increase(totals, OFF_ROAD, 1)
    off_road[rider] = is_off

    touching = wp.where(touches_obstacle(rider, rules, path, riders, obstacles), 1, 0)
    if touching == 1 and struck[rider] == 0:
        struck_count[rider] = struck_count[rider] + 1
        atomic_increase(totals, STRUCK, 1)
    struck[rider] = touching

    begun = wp.int32(0)
    around = 2.0 * rules.body_length
    columns = wp.vec2i(
        int(wp.floor((place[0] - around) / table.cell_size)), int(wp.floor((place[0] + around) / table.cell_size))
    )
    rows = wp.vec2i(
        int(wp.floor((place[1] - around) / table.cell_size)), int(wp.floor((place[1] + around) / table.cell_size))
    )
    for row in range(rows[0], rows[1] + 1):
        for column in range(columns[0], columns[1] + 1):
            other = table.heads[cell_entry(column, row, table)]
            while other != NOBODY:
                if other > rider and wp.length(table.places[other] - place) < around:
                    now = bodies_overlap(place, heading, table.places[other], riders.heading[other], rules)
                    if now:
                        before = not begins and bodies_overlap(
                            previous_in[rider],
                            previous_heading_in[rider],
                            previous_in[other],
                            previous_heading_in[other],
                            rules,
                        )
                        if not before:
                            enter_partner(rider, other, begun, partners_out)
                            begun += 1
                other = table.nexts[other]
    begun_out[rider] = begun
    if begun > 0:
        collisions[rider] = collisions[rider] + begun
        atomic_increase(totals, COLLISIONS, begun)


@wp.kernel
def remember(
    # state in
    table: CellTable,
    riders: RoadRiders,
    # state in and out
    frames: wp.array[wp.int32],
    # out
    previous_out: wp.array[wp.vec2],
    previous_heading_out: wp.array[wp.vec2],
):
    """Keep everybody's place and direction for the next frame."""
    rider = wp.tid()
    previous_out[rider] = table.places[rider]
    previous_heading_out[rider] = riders.heading[rider]
    if rider == 0:
        frames[0] = frames[0] + 1


class RoadReferee:
    """Counts riders on a road.

    Attributes:
        arrays: What it has seen.
        finish: The whole distance, from the start line [m].
    """

    def __init__(self, count: int, finish: float, *, device: wp.DeviceLike = None) -> None:
        """Begin with nothing seen.

        Args:
            count: Riders, the user included.
            finish: Arc length from the start line, over all laps, at which a rider is there [m].
            device: Where the arrays live.
        """
        self.finish = finish
        self._count = count
        self._device = device

        def whole(*shape: int) -> wp.array:
            return wp.zeros(shape, dtype=wp.int32, device=device)

        def exact() -> wp.array:
            return wp.zeros(count, dtype=wp.float64, device=device)

        self.arrays = RoadRefereeArrays(
            totals=whole(len(ROAD_TOTALS)),
            progress=exact(),
            distance=exact(),
            off_road=whole(count),
            off_road_count=whole(count),
            struck=whole(count),
            struck_count=whole(count),
            begun=whole(count),
            partners=whole(count, PARTNER_LIMIT),
            collisions=whole(count),
            finish_frame=wp.full(count, UNFINISHED, dtype=wp.int32, device=device),
            shelter_sum=exact(),
            frames=whole(1),
            previous=wp.zeros(count, dtype=wp.vec2, device=device),
            previous_heading=wp.zeros(count, dtype=wp.vec2, device=device),
        )

    def phases(
        self,
        frame: wp.array[wp.int32],
        rules: RoadRules,
        path: CentrelineData,
        table: CellTable,
        riders: RoadRiders,
        obstacles: RoadObstacles,
        share: Share,
    ) -> list[Phase]:
        """What a look takes: how far everybody is, whom and what the share's own riders touch, what to remember."""
        a, device = self.arrays, self._device

        def time(first: int, count: int) -> None:
            inputs = [first, rules, path, self.finish, frame, riders, a.totals, a.progress, a.finish_frame]
            wp.launch(time_riders, count, inputs=inputs, device=device)

        def look(first: int, count: int) -> None:
            inputs = [first, rules, path, a.frames, table, riders, obstacles, a.previous, a.previous_heading]
            inputs += [a.totals, a.distance, a.off_road, a.off_road_count, a.struck, a.struck_count]
            inputs += [a.collisions, a.shelter_sum]
            wp.launch(judge, count, inputs=inputs, outputs=[a.begun, a.partners], device=device)

        def keep() -> None:
            outputs = [a.previous, a.previous_heading]
            wp.launch(remember, self._count, inputs=[table, riders, a.frames], outputs=outputs, device=device)

        return [share.everybody(time), share.own(look), [keep]]

    def totals(self) -> dict[str, int]:
        """The totals by name; waits for the device."""
        return dict(zip(ROAD_TOTALS, self.arrays.totals.numpy().tolist(), strict=True))

    def collisions(self) -> list[tuple[int, int]]:
        """Pairs that began to overlap in the frame looked at last, lower index first, sorted; waits for the device."""
        begun = np.minimum(self.arrays.begun.numpy(), PARTNER_LIMIT)
        partners = self.arrays.partners.numpy()
        return [(int(a), int(b)) for a in np.flatnonzero(begun) for b in partners[a, : begun[a]]]

    def state(self) -> dict[str, wp.array]:
        """What the next frame depends on, by name; the arrays themselves, without what follows from them."""
        return {
            field.name: getattr(self.arrays, field.name)
            for field in fields(self.arrays)
            if field.name not in ("begun", "partners", "totals")
        }

    def count_anew(self, user_count: int) -> None:
        """Make the totals those of the state, which has been loaded.

        Args:
            user_count: How many of the last riders are users, who do not count among the finished.
        """
        a = self.arrays
        finished = a.finish_frame.numpy()[: self._count - user_count] != UNFINISHED
        counts = (a.off_road_count.numpy(), a.collisions.numpy(), a.struck_count.numpy(), finished)
        a.totals.assign(np.array([part.sum() for part in counts], dtype=np.int32))
