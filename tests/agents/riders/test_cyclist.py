"""The cyclist by what a person would notice: balance, counter-steering, speed, hills, and falls that are falls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from echelon.agents.characters import character_named
from echelon.agents.riders.cyclist import DRAG_AREA, Cyclist
from echelon.agents.riders.limbs import leg_pose
from echelon.terrain.incline import InclineTerrain
from echelon.warp_kernels.frame import ChunkArrays, Engine
from echelon.warp_kernels.reference_run import ReferenceRun

FRAME_RATE = 30
GRAVITY = 9.80665
_NAMED = character_named("cyclist")  # shared with other tests, so that it is compiled once
assert isinstance(_NAMED, Cyclist)
CYCLIST: Cyclist = _NAMED
SUBSTEPS = CYCLIST.steps_per_second // FRAME_RATE

Floats = float | np.ndarray | list[float]


class Riders:
    """Riders side by side along x, each on a grade of its own, and what was seen of them in the last frames.

    Args:
        character: Who rides.
        speed: To start at and to ride at [m/s], one a rider.
        grade: Rise over run, one or one a rider.
        kept: How many frames are kept.
        walls: Where a wall stands across each rider's way [m].
    """

    def __init__(
        self,
        character: Cyclist,
        speed: Floats,
        *,
        grade: Floats = 0.0,
        kept: int = 600,
        walls: list[float] | None = None,
    ) -> None:
        self.character = character
        self.speed = np.asarray(speed, dtype=float)
        self.count = len(self.speed)
        self.grade = np.broadcast_to(np.asarray(grade, dtype=float), (self.count,))
        terrain = InclineTerrain.of(self.grade, walls)
        self.engine = Engine(character, self.count, terrain, substeps=SUBSTEPS, tick=6, threads=1)
        self.chunk = ChunkArrays.allocate(kept, self.count, character)
        self.engine.bind(self.chunk)
        self.engine.set_origins(InclineTerrain.starts(self.count))
        people = character.population(self.count, 3, 0.0, False, speed=self.speed, grade=self.grade)
        self.engine.set_q(people.q)
        self.engine.set_u(people.u)
        for name, values in people.parameters.items():
            self.engine.set_parameter(name, values)
        for name, values in people.memory.items():
            self.engine.set_memory(name, values)
        self.kept, self.frame = kept, 0
        self.head_for(0.0)

    def power(self, sustained: Floats, peak: Floats) -> None:
        """Let everybody be so strong [W], and rested."""
        spare = 60.0 * (np.asarray(peak) - np.asarray(sustained))
        for name, value in (("power_sustained", sustained), ("power_peak", peak)):
            self.engine.set_parameter(name, np.broadcast_to(value, (self.count,)))
        self.engine.set_memory("reserve", np.broadcast_to(spare, (self.count,)))

    def head_for(self, heading: Floats, look_ahead: Floats = 0.0, speed: np.ndarray | None = None) -> None:
        """Ride in a direction [rad], towards a point so far away or, at 0, by the paper's law."""
        speed = self.speed if speed is None else speed
        self.engine.set_command("velocity_x", speed * np.cos(heading))
        self.engine.set_command("velocity_y", speed * np.sin(heading))
        self.engine.set_command("look_ahead", np.broadcast_to(look_ahead, (self.count,)))

    def pursue(self, point: Callable[[np.ndarray], np.ndarray]) -> None:
        """Steer for what `point` gives for the riders' places in their lanes, both of shape [riders, 2] [m]."""
        place = self.engine.positions.numpy().astype(float)[:, :2] - InclineTerrain.starts(self.count)[:, :2]
        away = point(place) - place
        self.head_for(np.arctan2(away[:, 1], away[:, 0]), np.linalg.norm(away, axis=1))

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        for _ in range(round(seconds * FRAME_RATE)):
            if each is not None:
                each()
            self.engine.advance(self.frame % self.kept)
            self.frame += 1

    def strike(self, impulse: float) -> None:
        """Hit everybody from the right at the height of the hips [N s]."""
        q, u = self.engine.q.astype(float), self.engine.u.astype(float)
        blow = np.tile([0.0, impulse, 0.0], (self.count, 1))
        self.engine.set_u(u + self.character.body.generalized_impulse(q, "frame", (0.45, 0.0, 1.0), blow))

    def _kept(self, array: np.ndarray) -> np.ndarray:
        assert self.frame <= self.kept
        return array[: self.frame]

    def measure(self, name: str) -> np.ndarray:
        """Shape [frames, riders]."""
        return self._kept(self.chunk.measures.numpy())[..., self.character.records.index(name)]

    @property
    def poses(self) -> np.ndarray:
        """Of links in the lanes, shape [frames, riders, links, 7]."""
        poses = self._kept(self.chunk.poses.numpy()).astype(float)
        starts = InclineTerrain.starts(self.count)
        poses[..., :3] += (self._kept(self.chunk.origins.numpy()) - starts)[:, :, None]
        return poses

    @property
    def speeds(self) -> np.ndarray:
        return np.linalg.norm(self._kept(self.chunk.velocities.numpy()), axis=-1)

    @property
    def fallen(self) -> np.ndarray:
        return self._kept(self.chunk.fallen.numpy()).astype(bool)

    @property
    def headings(self) -> np.ndarray:
        x, y, z, w = np.moveaxis(self.poses[:, :, 0, 3:], -1, 0)
        return np.arctan2(-2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z))

    def gaps(self) -> np.ndarray:
        """Between the ends of each spring [m], shape [springs, frames, riders]."""
        poses, names, found = self.poses, self.character.body.link_names, []
        for spring in self.character.body.springs:
            ends = []
            for link, place in ((spring.link_a, spring.position_a), (spring.link_b, spring.position_b)):
                assert link is not None
                pose = poses[:, :, names.index(link)]
                ends.append(pose[..., :3] + _rotated(pose[..., 3:], np.array(place)))
            found.append(np.linalg.norm(ends[1] - ends[0], axis=-1))
        return np.array(found)


def _rotated(quaternions: np.ndarray, vector: np.ndarray) -> np.ndarray:
    v = quaternions[..., :3]
    turn = 2.0 * np.cross(v, np.broadcast_to(vector, v.shape))
    return vector + quaternions[..., 3:] * turn + np.cross(v, turn)


def _circling(radius: np.ndarray, speed: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A point ahead on circles that begin at the origin along x and turn left."""

    def point(place: np.ndarray) -> np.ndarray:
        angle = np.arctan2(place[:, 1] - radius, place[:, 0])
        angle = angle + 2.0 * np.arcsin(np.minimum(np.maximum(8.0, 1.5 * speed) / (2.0 * radius), 1.0))
        return np.column_stack([radius * np.cos(angle), radius + radius * np.sin(angle)])

    return point


def _winding(place: np.ndarray, speed: np.ndarray, amplitude: Floats, wavelength: Floats) -> np.ndarray:
    x = place[:, 0] + np.maximum(8.0, 1.5 * speed)
    return np.column_stack([x, amplitude * np.sin(2.0 * np.pi * x / wavelength)])


@pytest.fixture(scope="module")
def straight() -> Riders:
    """Twenty seconds straight ahead at every speed."""
    riders = Riders(CYCLIST, [1.25, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 13.5, 14.0])
    riders.run(20)
    return riders


def test_holds_its_speed_and_its_line(straight: Riders) -> None:
    assert not straight.fallen.any()
    late = straight.speeds[10 * FRAME_RATE :]
    assert np.abs(late.mean(axis=0) - straight.speed).max() < 0.3
    assert np.degrees(np.abs(straight.measure("lean"))).max() < 1.5
    assert np.abs(straight.poses[:, :, 0, 1]).max() < 0.5


def test_hands_and_feet_stay_where_they_belong(straight: Riders) -> None:
    assert straight.gaps().max() < 0.007


def test_pedals_at_eighty_a_minute_with_the_angles_of_cyclists(straight: Riders) -> None:
    cadence = straight.measure("cadence")[10 * FRAME_RATE :].mean(axis=0)
    usual = (straight.speed >= 3.0) & (straight.speed <= 12.5)
    assert np.abs(cadence[usual] - 80.0).max() < 3.0
    pelvis, thigh, shank, foot = (
        _pitch(straight.poses[30:, :, CYCLIST.body.link_index(name), 3:])
        for name in ("frame", "left_upper_leg", "left_lower_leg", "left_foot")
    )
    riders = straight.speed >= 3.0
    # Published: hip (the thigh from the vertical) 32 to 70, knee 46 to 112, ankle about -2 to 22 degrees.
    for found, least, most in ((pelvis - thigh, 32, 70), (shank - thigh, 46, 112), (shank - foot, -2, 22)):
        degrees = np.degrees(found[:, riders])
        assert np.abs(degrees.min(axis=0) - least).max() < 8.0
        assert np.abs(degrees.max(axis=0) - most).max() < 8.0


def _pitch(quaternions: np.ndarray) -> np.ndarray:
    """Turn about y of links that hardly turn otherwise."""
    return 2.0 * np.arctan2(quaternions[..., 1], quaternions[..., 3])


@pytest.mark.parametrize("look_ahead", [0.0, 20.0])
def test_steers_the_other_way_to_turn(look_ahead: float) -> None:
    riders = Riders(CYCLIST, [3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 13.0])
    riders.head_for(0.0, look_ahead)
    riders.run(3)
    riders.head_for(np.radians(20.0), look_ahead)
    riders.run(15)
    assert not riders.fallen.any()
    steer, heading = np.degrees(riders.measure("steer")), np.degrees(riders.headings)
    turning = steer[3 * FRAME_RATE : 4 * FRAME_RATE]
    # Right first, by more than pedalling wiggles, then left.
    assert (turning.min(axis=0) < -0.7).all()
    assert (turning.argmin(axis=0) < 15).all()
    leaning = np.degrees(riders.measure("lean"))[3 * FRAME_RATE : 5 * FRAME_RATE]
    assert (leaning.min(axis=0) < -1.0).all()
    assert np.abs(heading[-1] - 20.0).max() < 2.0
    assert heading.max() < 26.0


def test_leans_into_steady_turns_as_physics_demands() -> None:
    speed = np.array([5.0, 8.0, 10.0, 3.0, 4.0, 6.0, 12.0, 14.0])
    radius = np.array([20.0, 20.0, 30.0, 10.0, 8.0, 15.0, 60.0, 90.0])
    riders = Riders(CYCLIST, speed, kept=900)
    riders.run(30, lambda: riders.pursue(_circling(radius, speed)))
    assert not riders.fallen.any()
    late = slice(20 * FRAME_RATE, None)
    place = riders.poses[late, :, 0]
    ridden = np.hypot(place[..., 0], place[..., 1] - radius)
    assert np.abs(ridden - radius).max() < 0.3
    lean = -np.degrees(riders.measure("lean")[late].mean(axis=0))
    expected = np.degrees(np.arctan(riders.speeds[late].mean(axis=0) ** 2 / (GRAVITY * ridden.mean(axis=0))))
    assert np.abs(lean - expected).max() < 0.5
    assert riders.gaps().max() < 0.01


def test_what_the_crank_gives_is_what_riding_takes() -> None:
    grade = np.array([0.0, 0.0, 0.0, 0.03, 0.08, 0.13, -0.04, -0.04])
    riders = Riders(CYCLIST, [4.0, 8.0, 12.0, 6.0, 3.7, 4.2, 6.0, 10.0], grade=grade, kept=1500)
    riders.power(550.0, 550.0)
    riders.run(50)
    assert not riders.fallen.any()
    first, last = 10 * FRAME_RATE, 50 * FRAME_RATE - 1
    given = riders.measure("power")[first:last].sum(axis=0) / FRAME_RATE
    speed, height = riders.speeds, riders.poses[:, :, 0, 2]
    v = speed[first:last]
    p, mass = CYCLIST.bicycle, CYCLIST.body.mass
    wheels = (p.rear_wheel.radius**-2 + p.front_wheel.radius**-2) * p.rolling_resistance
    resisted = (wheels * v**2 + 0.5 * 1.2 * DRAG_AREA * v**3).sum(axis=0) / FRAME_RATE
    turning = (p.rear_wheel.inertia_y + p.front_wheel.inertia_y) / p.rear_wheel.radius**2
    gained = mass * GRAVITY * (height[last] - height[first])
    gained = gained + 0.5 * (mass + turning) * (speed[last] ** 2 - speed[first] ** 2)
    assert np.abs(given / (resisted + gained) - 1.0).max() < 0.02


def test_hills_slow_riders_by_their_power() -> None:
    riders = Riders(CYCLIST, [3.5, 4.0, 2.4, 6.0], grade=[0.08, 0.13, 0.13, 0.08], kept=900)
    riders.power([300.0, 550.0, 300.0, 550.0], [300.0, 550.0, 300.0, 550.0])
    riders.speed = np.full(4, 9.0)
    riders.head_for(0.0)
    riders.run(30)
    assert not riders.fallen.any()
    climbed = riders.speeds[15 * FRAME_RATE :].mean(axis=0)
    assert climbed == pytest.approx([3.75, 4.3, 2.37, 6.3], abs=0.25)


def test_spends_a_reserve_and_recovers() -> None:
    riders = Riders(CYCLIST, [5.0], grade=0.05, kept=5400)
    riders.speed = np.array([9.0])
    riders.head_for(0.0)
    riders.run(100)
    power = riders.measure("power")[:, 0]
    assert power[10 * FRAME_RATE : 50 * FRAME_RATE].mean() == pytest.approx(550.0, abs=15.0)
    assert power[80 * FRAME_RATE : 100 * FRAME_RATE].mean() == pytest.approx(300.0, abs=10.0)
    riders.speed = np.array([2.0])
    riders.head_for(0.0)
    riders.run(80)
    assert riders.engine.memory("reserve")[0] > 4000.0


def test_brakes_for_what_is_commanded() -> None:
    riders = Riders(CYCLIST, [8.0, 12.0, 12.0], grade=[0.0, 0.0, -0.10])
    riders.run(2)
    riders.speed = np.array([4.0, 5.0, 6.0])
    riders.head_for(0.0)
    riders.run(8)
    assert not riders.fallen.any()
    assert np.abs(riders.speeds[-FRAME_RATE:].mean(axis=0) - riders.speed).max() < 1.0
    assert riders.speeds[5 * FRAME_RATE].max() < 9.0
    assert (riders.chunk.phases.numpy()[: riders.frame] == CYCLIST.phase_names.index("braking")).any()
    assert riders.gaps().max() < 0.01


def test_survives_blows_from_the_side() -> None:
    riders = Riders(CYCLIST, np.linspace(2.0, 14.0, 8))
    for blow in (60.0, -100.0):
        riders.run(3)
        riders.strike(blow)
    riders.run(8)
    assert not riders.fallen.any()
    assert np.degrees(np.abs(riders.measure("lean"))).max() > 3.0
    assert np.degrees(np.abs(riders.measure("lean"))[-FRAME_RATE:]).max() < 1.0


def test_obeys_wild_commands_without_falling() -> None:
    random = np.random.default_rng(5)
    riders = Riders(CYCLIST, random.uniform(2.0, 13.0, 24), kept=1800)
    heading, look_ahead = np.zeros(24), np.full(24, 15.0)

    def change_mind() -> None:
        changing = random.random(24) < 1.0 / 60.0
        heading[changing] += random.uniform(-2.0, 2.0, changing.sum())
        look_ahead[changing] = random.uniform(6.0, 25.0, changing.sum())
        change = np.where(changing, random.uniform(-3.0, 3.0, 24), 0.0)
        riders.speed = np.clip(riders.speed + change, 2.0, 14.0)
        riders.head_for(heading, look_ahead)

    riders.run(60, change_mind)
    assert not riders.fallen.any()
    lean = np.degrees(np.abs(riders.measure("lean")))
    assert 25.0 < lean.max() < 40.0
    assert riders.gaps().max() < 0.01


def test_asked_for_the_impossible_it_falls_and_comes_to_rest() -> None:
    speed = np.array([10.0, 10.0, 8.0, 12.0])
    curvature = np.array([0.10, 0.15, 0.25, 0.10])
    riders = Riders(CYCLIST, speed)
    riders.engine.set_parameter("lean_limit", np.full(4, 1.0))
    riders.head_for(0.0, 15.0)
    riders.run(1.5)

    def bend() -> None:
        riders.head_for(riders.headings[-1] + np.arcsin(np.minimum(0.5 * curvature * 1.4 * speed, 0.99)), 1.4 * speed)

    riders.run(12, bend)
    assert riders.fallen[-1].all()
    events = riders.chunk.events.numpy()[: riders.frame, :, 0] >= 0
    assert (events.sum(axis=0) == 1).all()
    lying = riders.poses[-1]
    names = CYCLIST.body.link_names
    for part in ("pelvis", "upper_body", "left_lower_leg", "right_lower_leg"):
        height = lying[:, names.index(part), 2]
        assert (height > -0.05).all()
        assert (height < 0.75).all()
    assert np.abs(riders.poses[-1, :, :, :3] - riders.poses[-FRAME_RATE, :, :, :3]).max() < 0.15
    assert riders.speeds[-1].max() < 0.2
    assert not riders.engine.frozen.any()
    assert riders.gaps()[:2, -1].max() > 0.2  # the hands have let go


def test_a_parked_car_stops_it() -> None:
    riders = Riders(CYCLIST, [4.0, 6.0, 8.0], walls=[12.0, 12.0, 12.0])
    riders.run(8)
    front = riders.poses[:, :, CYCLIST.body.link_index("front_wheel"), 0] + CYCLIST.bicycle.front_wheel.radius
    assert (front.max(axis=0) > 11.5).all()
    assert (riders.poses[:, :, 0, 0].max(axis=0) < 12.5).all()


def test_ten_minutes_alone() -> None:
    # Straight, winding, winding down a long descent, and simply down it.
    speed = np.array([5.0, 10.0, 6.0, 10.0, 8.0, 12.0, 10.0, 14.0])
    grade = np.array([0.0, 0.0, 0.0, 0.0, -0.04, -0.04, -0.08, -0.04])
    amplitude = np.array([0.0, 0.0, 4.0, 4.0, 4.0, 4.0, 0.0, 0.0])
    riders = Riders(CYCLIST, speed, grade=grade)
    worst = np.zeros(8)
    for minute in range(10):
        riders.frame = 0
        for _ in range(60 * FRAME_RATE):
            riders.pursue(lambda place: _winding(place, speed, amplitude, 120.0))
            riders.engine.advance(riders.frame % riders.kept)
            riders.frame += 1
        place = riders.engine.positions.numpy().astype(float) - InclineTerrain.starts(8)
        off = place[:, 1] - amplitude * np.sin(2.0 * np.pi * place[:, 0] / 120.0)
        worst = np.maximum(worst, np.abs(off))
        assert not riders.engine.fallen.numpy().any(), f"minute {minute}"
    assert riders.engine.positions.numpy()[:, 0].min() > 2500.0
    assert worst.max() < 0.5
    riders.frame = riders.kept
    assert riders.gaps().max() < 0.01


def test_the_rider_of_1995_on_a_freewheel_rides_straight_and_round_bends() -> None:
    other = Cyclist(fifteen_segments=True, freewheel=True)
    speed = np.array([3.0, 5.0, 8.0, 10.0, 5.0, 8.0, 10.0, 3.0])
    radius = np.array([1e6, 1e6, 1e6, 1e6, 20.0, 20.0, 30.0, 10.0])
    riders = Riders(other, speed, kept=750)
    riders.run(25, lambda: riders.pursue(_circling(radius, speed)))
    assert not riders.fallen.any()
    late = slice(15 * FRAME_RATE, None)
    assert np.abs(riders.speeds[late].mean(axis=0) - speed).max() < 0.3
    lean = -np.degrees(riders.measure("lean")[late].mean(axis=0))
    assert np.abs(lean - np.degrees(np.arctan(riders.speeds[late].mean(axis=0) ** 2 / (GRAVITY * radius)))).max() < 1.0
    assert riders.gaps().max() < 0.01
    # Slowing down, the wheel runs ahead of what the cranks would turn it at, and no one pushes backwards.
    riders.frame = 0
    riders.speed = 0.5 * speed
    riders.run(1, lambda: riders.pursue(_circling(radius, speed)))
    assert riders.measure("crank_torque").min() > -1e-3
    assert riders.measure("power").min() > -1.0


def test_starts_on_the_road_with_hands_and_feet_in_place() -> None:
    heading, grade = np.linspace(-3.0, 3.0, 9), np.linspace(-0.1, 0.13, 9)
    some = CYCLIST.population(9, 7, 0.05, False, heading=heading, speed=6.0, grade=grade)
    more = CYCLIST.population(20, 7, 0.05, False, heading=heading[0], speed=6.0, grade=grade[0])
    assert np.array_equal(some.q[0], more.q[0])
    for name in some.parameters:
        assert np.array_equal(some.parameters[name], more.parameters[name][:9])
    body = CYCLIST.body
    poses = body.link_poses(some.q)
    for spring in body.springs:
        ends = []
        for link, place in ((spring.link_a, spring.position_a), (spring.link_b, spring.position_b)):
            pose = poses[:, body.link_index(link or "")]
            ends.append(pose[:, :3] + _rotated(pose[:, 3:], np.array(place)))
        assert np.abs(ends[1] - ends[0]).max() < 1e-9, spring.name
    velocities = body.link_velocities(some.q, some.u)[:, 0, :3]
    assert np.allclose(velocities[:, 2] / np.hypot(velocities[:, 0], velocities[:, 1]), grade)
    assert np.allclose(np.arctan2(velocities[:, 1], velocities[:, 0]), heading)


def test_lanes_agree_with_the_reference() -> None:
    riders = Riders(CYCLIST, [7.0])
    riders.run(1.0)
    state = riders.engine.full_state()["state"][0].astype(float)
    q = riders.engine.q.astype(float)
    q[:, :3] = riders.engine.positions.numpy()  # where it is in the world, not from its floating origin
    run = ReferenceRun(CYCLIST, q, riders.engine.u, step=riders.engine.step, tick=6)
    layout = riders.engine.layout
    run.state.memory.update({name: np.array([state[at]]) for name, at in layout.memory.items()})
    for strain, first in zip(run.state.strains, layout.strain, strict=True):
        for i in range(len(strain)):
            strain[i] = np.array([state[first + i]])
    run.command["velocity_x"][:] = 7.0
    riders.run(1.0 / FRAME_RATE)
    run.frame(SUBSTEPS)
    assert np.abs(run.u - riders.engine.u).max() < 0.02
    moved = run.q[:, 3:] - riders.engine.q[:, 3:]
    assert np.abs(moved).max() < 1e-3


def test_legs_push_pedals_with_the_force_that_is_asked_for() -> None:
    # Torques times joint rates are the force times the pedal's motion, whatever the leg does.
    random = np.random.default_rng(2)
    angle, nudge = random.uniform(0.0, 2.0 * np.pi, 50), 1e-6
    force = random.normal(0.0, 100.0, (2, 50))
    rider, bicycle = CYCLIST.rider, CYCLIST.bicycle
    here, there = (leg_pose(rider, bicycle, np.sin(a), np.cos(a), 0.6) for a in (angle, angle + nudge))
    work = sum(
        torque * (getattr(there, joint) - getattr(here, joint)) / nudge
        for torque, joint in zip(here.torques((force[0], force[1])), ("hip", "knee", "ankle"), strict=True)
    )
    motion = [(there.arms[0][i] - here.arms[0][i]) / nudge for i in range(2)]
    assert np.allclose(work, force[0] * motion[0] + force[1] * motion[1], atol=1e-3)
