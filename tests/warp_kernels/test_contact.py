"""Contact against what mechanics says: blocks on slopes, drops, rolling, spinning, walls, and no adhesion anywhere."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from engine_scenes import (
    GRAVITY,
    STEP,
    as_float32,
    ball_body,
    block_body,
    diagonal,
    free_link,
    on_slope,
    slope_normal,
    start,
)
from scipy.spatial.transform import Rotation

from echelon.agents.servo import ServoedBody
from echelon.warp_kernels import articulated
from echelon.warp_kernels.character import View
from echelon.warp_kernels.contact import PEEL_ACCELERATION, JointForces, _deepest, _travel, contact
from echelon.warp_kernels.kinematics import kinematics
from echelon.warp_kernels.model import ContactSite, Integration, Joint, Link
from echelon.warp_kernels.program import Integrator
from echelon.warp_kernels.reference import Body
from echelon.warp_kernels.reference_run import ReferenceRun
from echelon.warp_kernels.spatial import add, apply_transposed, cross, dot

BOTH: tuple[Integration, ...] = ("implicit", "explicit")


class Pulled(ServoedBody):
    """A free body under a steady force and moment: parameters pull_x, pull_y, pull_z [N], turn_x, ... [N m]."""

    pulls = ("pull_x", "pull_y", "pull_z", "turn_x", "turn_y", "turn_z")

    def __init__(self, body: Body) -> None:
        super().__init__(body, 0.0, 0.0)
        self.parameters: Mapping[str, float] = {**self.parameters, **dict.fromkeys(self.pulls, 0.0)}

    def actuate(self, view: View, joints: JointForces) -> None:
        super().actuate(view, joints)
        for i, name in enumerate(self.pulls):
            joints.tau[i] = joints.tau[i] + view.parameters[name]


def passive(body: Body) -> ServoedBody:
    return ServoedBody(body, 0.0, 0.0)


def downhill(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


# ---- a block on a slope ----------------------------------------------------------------------------------------------
FRICTION = 0.5
FRICTION_ANGLE = float(np.arctan(FRICTION))
BLOCK_MASS, BLOCK_STIFFNESS = 4.0, 20_000.0


def slope_block(integration: Integration) -> ServoedBody:
    return passive(
        block_body(
            mass=BLOCK_MASS,
            stiffness=BLOCK_STIFFNESS,
            damping=200.0,
            tangential_stiffness=BLOCK_STIFFNESS,
            tangential_damping=200.0,
            friction=FRICTION,
            integration=integration,
        )
    )


def resting_on(character: ServoedBody, angle: float) -> np.ndarray:
    """q of the block pressed in as deeply as its weight will press it."""
    depth = BLOCK_MASS * GRAVITY * np.cos(angle) / 4.0 / BLOCK_STIFFNESS
    return on_slope(character.body, angle, 0.05 - depth)


@pytest.mark.parametrize("integrator", ["semi-implicit", "rk4"])
@pytest.mark.parametrize("integration", BOTH)
def test_a_block_slides_above_the_friction_angle(integration: Integration, integrator: Integrator):
    character = slope_block(integration)
    for angle in (FRICTION_ANGLE + 0.03, 0.7):
        flight = start(character, resting_on(character, angle), angle=angle, integrator=integrator)
        speed = [float(flight.advance(15).u[0, :3] @ downhill(angle)) for _ in range(4)]
        expected = GRAVITY * (np.sin(angle) - FRICTION * np.cos(angle))
        assert speed[3] - speed[1] == pytest.approx(expected, rel=0.02)
        # It slides straight, flat on the ground.
        assert np.max(np.abs(flight.u[0, 3:])) < 1e-3
        assert abs(flight.q[0, 1]) < 1e-3


@pytest.mark.parametrize("integrator", ["semi-implicit", "rk4"])
@pytest.mark.parametrize("integration", BOTH)
def test_a_block_sticks_below_the_friction_angle(integration: Integration, integrator: Integrator):
    character = slope_block(integration)
    for angle in (0.1, FRICTION_ANGLE - 0.03):
        flight = start(character, resting_on(character, angle), angle=angle, integrator=integrator)
        placed = flight.q[0, :3]
        settled = flight.advance(30).q[0, :3]
        # It gives way as the anchors' springs do, and stands.
        give = BLOCK_MASS * GRAVITY * np.sin(angle) / 4.0 / BLOCK_STIFFNESS
        assert give < (settled - placed) @ downhill(angle) < 3.0 * give
        assert np.max(np.abs(flight.u)) < 2e-5
        assert np.linalg.norm(flight.advance(30).q[0, :3] - settled) < 5e-6


def test_a_sliding_block_pressed_down_is_braked_by_all_the_friction_there_is():
    """Where the damper alone asks for more than the limit, the spring must not lean the other way when it lets off."""
    body = block_body(mass=BLOCK_MASS, stiffness=60_000.0, damping=200.0, tangential_damping=1000.0, friction=0.8)
    q = body.q_reference.copy()
    q[2] -= BLOCK_MASS * GRAVITY / 4.0 / 60_000.0
    flight = start(Pulled(body), q, np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]), frame_rate=1200, substeps=1, tick=1)
    flight.advance(20)
    speed, place, press = flight.u[0, 0], flight.q[0, 0], 360.0
    flight.engine.set_parameter("pull_z", np.array([-press]))
    farthest = max(float(flight.advance(1).q[0, 0]) for _ in range(200)) - place
    stopping = 0.5 * speed**2 / (0.8 * (GRAVITY + press / BLOCK_MASS))
    # The load takes some milliseconds to build up, and the anchors give way by two millimetres.
    assert stopping < farthest < stopping + 0.0025


@pytest.mark.parametrize("integration", BOTH)
def test_anchors_hold_for_a_minute_without_creep(integration: Integration):
    """What is left in float32 is that an orientation cannot turn by less than its last bit: half a micron a second."""
    character = slope_block(integration)
    angle = FRICTION_ANGLE - 0.03
    flight = start(character, resting_on(character, angle), angle=angle).advance(30)
    settled = flight.q[0]
    flight.advance(60 * 30)
    assert np.linalg.norm(flight.q[0, :3] - settled[:3]) < 5e-5
    assert np.linalg.norm(flight.q[0, 3:] - settled[3:]) < 1e-5


def test_anchors_do_not_creep_at_all_in_float64():
    character = slope_block("implicit")
    angle = FRICTION_ANGLE - 0.03
    planes = [(*slope_normal(angle), 0.0)] * 4
    run = ReferenceRun(character, resting_on(character, angle)[None], np.zeros((1, 6)), planes=planes, step=1 / 600)
    for _ in range(200):
        run.substep()
    assert np.max(np.abs(run.u)) < 1e-10


# ---- no adhesion -----------------------------------------------------------------------------------------------------
def site_forces(run: ReferenceRun) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Of the present state: normal force of each site as it acts, implicit part included [N]; the acceleration of its
    material point along the normal [m/s^2]; and the accelerations of all speeds.

    What acts is force - mass a - coupling^T alpha, about the link's origin in its axes (see `ContactLoad`).
    """
    body = run.character.body
    result = run.evaluate(run.state, run.step, run.step)
    kin = kinematics(body.tree, run.state.q, run.state.u)
    accelerations = articulated.link_accelerations(kin, result.qdd)
    forces, rises = [], []
    for site, plane, strain in zip(body.contacts, run.planes, run.state.strains, strict=True):
        place = body.tree.node_of_link[body.link_index(site.link)]
        step = run.step if site.integration == "implicit" else 0.0
        load = contact(kin, body, site, plane, strain, run.step, run.step).load
        alpha, a = accelerations[place]
        rotation, _ = kin.world(place)
        acting = [
            load.force[i]
            - (0.0 if step == 0.0 else sum(load.mass[i][j] * a[j] + load.coupling[j][i] * alpha[j] for j in range(3)))
            for i in range(3)
        ]
        normal = apply_transposed(rotation, list(plane[:3]))
        forces.append(dot(normal, acting))
        point = [p - r * n for p, r, n in zip(site.position, site.radii, normal, strict=True)]  # spheres and points
        omega = kin.omega[place]
        true_a = add(a, add(cross(alpha, point), cross(omega, cross(omega, point))))
        rises.append(dot(normal, true_a) - body.gravity * plane[2])
    return forces, rises, np.stack(result.qdd, axis=-1)


def batch_in_contact(body: Body, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses up to a centimetre in or out of level ground, tilted and moving in any way."""
    rng = np.random.default_rng(seed)
    q = np.tile(body.q_reference, (count, 1))
    q[:, 2] += rng.uniform(-0.01, 0.002, size=count)
    q[:, 3:6] = rng.uniform(-0.02, 0.02, size=(count, 3))
    u = rng.normal(size=(count, 6)) * ([1.0] * 3 + [3.0] * 3)
    return body.normalized(q), u


@pytest.mark.parametrize("integration", BOTH)
@pytest.mark.parametrize("shape", ["ball", "block"])
def test_the_normal_force_never_pulls(shape: str, integration: Integration):
    """Thousands of states, impacts among them, with pulls up to 8 g: every site pushes or does nothing.

    A site with an implicit force may pull, for this substep, if it is being torn away at more than 3 g.
    """
    body = ball_body(integration=integration) if shape == "ball" else block_body(integration=integration)
    character = Pulled(body)
    count = 4000
    q, u = batch_in_contact(body, count, seed=21)
    rng = np.random.default_rng(22)
    pulls = {
        "pull_z": body.mass * GRAVITY * rng.uniform(-1.0, 8.0, size=count),
        "pull_x": 20.0 * rng.normal(size=count),
    }
    run = ReferenceRun(character, q, u, parameters=pulls)
    for strain in run.state.strains:
        for i in range(3):
            strain[i][:] = rng.uniform(-2e-3, 2e-3, size=count)
    forces, rises, qdd = site_forces(run)
    for force, rise in zip(forces, rises, strict=True):
        torn = (rise > PEEL_ACCELERATION) & (integration == "implicit")
        assert np.min(force[~torn]) >= -1e-9
        assert np.count_nonzero(force[~torn] > 1.0) > count // 50
    # All forces together, from the acceleration that they cause (level ground: the ground's part is what is left).
    total = body.mass * (qdd[:, 2] + GRAVITY) - pulls["pull_z"]
    np.testing.assert_allclose(total, sum(forces), atol=1e-6)


@pytest.mark.parametrize("integration", BOTH)
def test_in_the_air_a_site_does_nothing_at_all(integration: Integration):
    """From rest over a slope, pushed and turned: the very first step is a free body's."""
    body = ball_body(integration=integration, patch_radius=0.03)
    character = Pulled(body)
    q = on_slope(body, 0.4, 0.5)[None]
    planes = [(*slope_normal(0.4), 0.0)]
    pushes = {"pull_x": 3.0, "pull_y": -2.0, "turn_z": 0.5, "turn_x": 0.2}
    run = ReferenceRun(character, q, np.zeros((1, 6)), planes=planes, parameters=pushes)
    found = run.evaluate(run.state, run.step, run.step).qdd
    inertia = 0.4 * 3.0 * 0.2**2
    expected = [1.0, -2.0 / 3.0, -GRAVITY, 0.2 / inertia, 0.0, 0.5 / inertia]
    np.testing.assert_allclose(np.array(found)[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("integration", BOTH)
def test_a_body_lifted_off_is_never_held_back(integration: Integration):
    """A ball at rest in its dent is pulled up: it is never lower or slower than if there were no ground."""
    body = ball_body(integration=integration, stiffness=20_000.0, damping=300.0)
    weight = body.mass * GRAVITY
    factors = np.array([1.05, 1.5, 2.0, 3.0, 4.0])
    q = np.tile(body.q_reference, (5, 1))
    q[:, 2] -= weight / 20_000.0
    flight = start(Pulled(body), q, frame_rate=1200, substeps=1, tick=1)
    flight.engine.set_parameter("pull_z", factors * weight)
    free = GRAVITY * (factors - 1.0)
    height, speed = flight.q[:, 2], flight.u[:, 2]
    for _ in range(60):
        flight.advance(1)
        assert np.all(flight.u[:, 2] - speed >= free * STEP - 1e-6)
        assert np.all(flight.q[:, 2] >= height)
        height, speed = flight.q[:, 2], flight.u[:, 2]
    airborne = height > 0.2
    assert np.all(airborne[1:])
    # What has left the ground has left its anchor.
    first = flight.engine.layout.strain[0]
    assert np.all(flight.engine.full_state()["state"][airborne, first : first + 3] == 0.0)


# ---- stiff friction on something light -------------------------------------------------------------------------------
def foot_with_light_toe(integration: Integration) -> ServoedBody:
    """Five kilograms on heels and a hinged toe of a hundred grams, on sites as stiff as a man's.

    A force up or sideways at the toe's tip moves fifty grams: damping alone, h c / m, is 25 and 17 at 1/1200 s.
    """
    heel = Link("foot", None, Joint("root", "free", position=(0.0, 0.0, 0.1)), 5.0, inertia=diagonal(0.05, 0.08, 0.06))
    toe = Link(
        "toe",
        "foot",
        Joint("hinge", "universal", position=(0.1, 0.0, -0.08), axes=((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        0.1,
        com=(0.02, 0.0, 0.0),
        inertia=diagonal(4e-5, 4e-5, 4e-5),
    )
    stiff: dict[str, Any] = {
        "stiffness": 70_000.0,
        "damping": 1500.0,
        "tangential_stiffness": 50_000.0,
        "tangential_damping": 1000.0,
    }
    sites = [
        ContactSite(f"heel {side}", "foot", (-0.1, 0.05 * side, -0.1), integration="implicit", **stiff)
        for side in (-1, 1)
    ] + [
        ContactSite(f"toe {side}", "toe", (0.04, 0.03 * side, -0.02), integration=integration, **stiff)
        for side in (-1, 1)
    ]
    return ServoedBody(Body(name="foot", links=(heel, toe), contacts=tuple(sites)), 80.0, 0.3)


def shoved(integration: Integration, step: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Standing, and shoved forwards or sideways: it slides, slows and sticks; three different speeds."""
    character = foot_with_light_toe(integration)
    q = np.tile(character.body.q_reference, (3, 1))
    q[:, 2] -= 2e-4
    u = np.zeros((3, 8))
    u[:, 0], u[:, 1] = (0.0, 0.2, -0.1), (0.1, 0.0, 0.15)
    run = ReferenceRun(character, q, u, step=step)
    with np.errstate(all="ignore"):
        for _ in range(round(seconds / step)):
            run.substep()
    return run.q, run.u


def test_stiff_friction_under_a_light_toe_converges_with_the_step():
    ends = [shoved("implicit", STEP / n, 0.04)[0] for n in (1, 2, 4)]
    errors = [np.max(np.abs(a - b)) for a, b in itertools.pairwise(ends)]
    assert errors[0] < 1e-3
    assert errors[1] < 0.65 * errors[0]


def test_stiff_friction_under_a_light_toe_comes_to_rest_at_the_usual_step():
    character = foot_with_light_toe("implicit")
    q = np.tile(character.body.q_reference, (8, 1))
    u = np.zeros((8, 8))
    u[:, 0], u[:, 1], u[:, 2] = np.linspace(-0.5, 0.5, 8), np.linspace(0.4, -0.2, 8), -0.3
    flight = start(character, q, u)
    fastest = max(float(np.max(np.abs(flight.advance(1).u))) for _ in range(6))
    assert fastest < 4.0
    flight.advance(54)
    assert np.max(np.abs(flight.u)) < 1e-3
    # Explicitly the same toe rattles.
    _, calm = shoved("implicit", STEP, 0.02)
    _, wild = shoved("explicit", STEP, 0.02)
    assert np.max(np.abs(wild)) > 20.0 * np.max(np.abs(calm))


# ---- drops -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("integration", BOTH)
@pytest.mark.parametrize("damping", [0.0, 400.0])
def test_a_dropped_ball_rests_as_deep_as_its_weight_presses_it(integration: Integration, damping: float):
    """Energy, that of the dent included, never rises; without damping it is kept, in bounce after bounce."""
    stiffness, drop = 20_000.0, 0.2
    body = ball_body(stiffness=stiffness, damping=damping, integration=integration)
    q = body.q_reference.copy()
    q[2] += drop
    flight = start(passive(body), q, frame_rate=1200, substeps=1, tick=1)
    radius, weight = 0.2, body.mass * GRAVITY
    heights, speeds = [], []
    for _ in range(2400):
        flight.advance(1)
        heights.append(flight.q[0, 2] - radius)
        speeds.append(flight.u[0, 2])
    # A speed belongs to the middle of the step that it carries the ball over.
    height, speed = np.array(heights)[:-1], 0.5 * (np.array(speeds)[:-1] + np.array(speeds)[1:])
    energy = 0.5 * body.mass * speed**2 + weight * height + 0.5 * stiffness * np.maximum(-height, 0.0) ** 2
    rises = energy - np.minimum.accumulate(energy)
    assert np.max(rises) < 0.01 * weight * drop
    apexes = height[1:-1][(height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:]) & (height[1:-1] > 1e-4)]
    assert np.all(np.diff(apexes) < 1e-3 * drop)
    if damping == 400.0:
        assert height[-1] == pytest.approx(-weight / stiffness, rel=1e-3)
        assert abs(flight.u[0, 2]) < 1e-5
        assert np.max(height[600:]) < 0.0
    if damping == 0.0 and integration == "explicit":
        assert len(apexes) >= 4
        assert apexes[-1] == pytest.approx(drop, rel=0.02)


def test_a_block_dropped_askew_comes_to_rest_on_its_four_corners():
    character = slope_block("implicit")
    body = character.body
    q = np.tile(body.q_reference, (8, 1))
    rng = np.random.default_rng(8)
    q[:, 2] += 0.15
    q[:, 3:6] = rng.uniform(-0.15, 0.15, size=(8, 3))
    q, u = as_float32(body.normalized(q)), as_float32(0.5 * rng.normal(size=(8, 6)))
    flight = start(character, q, u).advance(120)
    depth = BLOCK_MASS * GRAVITY / 4.0 / BLOCK_STIFFNESS
    np.testing.assert_allclose(flight.q[:, 2], 0.05 - depth, atol=1e-5)
    assert np.max(np.abs(flight.q[:, 3:5])) < 1e-4
    assert np.max(np.abs(flight.u)) < 1e-4


# ---- rolling and spinning --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("integration", BOTH)
@pytest.mark.parametrize("integrator", ["semi-implicit", "rk4"])
def test_a_ball_rolls_down_a_slope_without_slip(integration: Integration, integrator: Integrator):
    """a = 5/7 g sin(angle)."""
    angle, radius = 0.25, 0.2
    body = ball_body(stiffness=40_000.0, damping=400.0, friction=0.6, integration=integration)
    depth = body.mass * GRAVITY * np.cos(angle) / 40_000.0
    q = on_slope(body, angle, radius - depth)
    flight = start(passive(body), q, angle=angle, integrator=integrator).advance(10)
    speeds, spins = [], []
    for _ in range(3):
        speeds.append(float(flight.u[0, :3] @ downhill(angle)))
        spins.append(float(flight.u[0, 4]))
        flight.advance(15)
    assert (speeds[2] - speeds[0]) == pytest.approx(5.0 / 7.0 * GRAVITY * np.sin(angle), rel=0.002)
    np.testing.assert_allclose(speeds, np.array(spins) * radius, rtol=1e-4)
    # Fast on level ground it neither lifts nor sinks: what touches changes all the time, and is not flung upwards.
    level = body.q_reference.copy()
    level[2] -= body.mass * GRAVITY / 40_000.0
    flight = start(passive(body), level, np.array([8.0, 0.0, 0.0, 0.0, 40.0, 0.0]), integrator=integrator).advance(10)
    assert flight.q[0, 2] == pytest.approx(level[2], abs=2e-6)
    assert flight.u[0, 0] == pytest.approx(8.0, rel=1e-5)


@pytest.mark.parametrize("radii", [(0.0, 0.0, 0.0), (0.2, 0.2, 0.2), (0.3, 0.1, 0.2), (0.4, 0.4, 0.05)])
def test_the_contact_point_travels_as_the_link_turns(radii: tuple[float, float, float]):
    """Against differences: where is the deepest point of a turning point, sphere, ellipsoid, disc a moment later?"""
    site = ContactSite("site", "link", (0.1, -0.2, 0.3), radii=radii)
    rng = np.random.default_rng(6)
    normal = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
    moment = 1e-6
    for _ in range(10):
        turn = Rotation.from_quat(rng.normal(size=4))
        omega = 3.0 * rng.normal(size=3)

        def place(time: float, turn: Rotation = turn, omega: np.ndarray = omega) -> np.ndarray:
            now = turn * Rotation.from_rotvec(omega * time)
            return now.apply(add(list(site.position), _deepest(site, list(now.inv().apply(normal)))))

        in_link = list(turn.inv().apply(normal))
        point = add(list(site.position), _deepest(site, in_link))
        expected = turn.inv().apply((place(moment) - place(-moment)) / (2.0 * moment))
        np.testing.assert_allclose(_travel(site, in_link, list(omega), point), expected, atol=1e-8)


@pytest.mark.parametrize("integration", BOTH)
def test_a_ball_slips_where_friction_is_too_small_to_roll_it(integration: Integration):
    """It slides as a block does, and is spun up by what friction there is."""
    angle, radius = 0.25, 0.2
    body = ball_body(stiffness=40_000.0, damping=400.0, friction=0.04, integration=integration)
    q = on_slope(body, angle, radius - body.mass * GRAVITY * np.cos(angle) / 40_000.0)
    flight = start(passive(body), q, angle=angle).advance(30)
    assert flight.u[0, :3] @ downhill(angle) == pytest.approx(
        GRAVITY * (np.sin(angle) - 0.04 * np.cos(angle)), rel=0.01
    )
    assert flight.u[0, 4] == pytest.approx(0.04 * GRAVITY * np.cos(angle) / (0.4 * radius), rel=0.02)


def test_rolling_resistance_brings_a_ball_to_rest():
    """Its lever arm e over 7/5 of the radius is the part of g by which it slows."""
    lever, radius = 0.01, 0.2
    body = ball_body(stiffness=40_000.0, damping=400.0, friction=0.8, rolling_resistance=lever)
    q = body.q_reference.copy()
    q[2] -= body.mass * GRAVITY / 40_000.0
    flight = start(passive(body), q, np.array([1.0, 0.0, 0.0, 0.0, 5.0, 0.0]))
    first = flight.advance(10).u[0, 0]
    second = flight.advance(30).u[0, 0]
    assert first - second == pytest.approx(lever * GRAVITY / (1.4 * radius), rel=0.02)
    assert np.max(np.abs(flight.advance(150).u)) < 2e-3


@pytest.mark.parametrize("integration", BOTH)
def test_a_patch_resists_spinning_up_to_its_limit(integration: Integration):
    """Friction times load times two thirds of the radius, as of a disc under even pressure."""
    patch, friction = 0.1, 0.6
    site = ContactSite(
        "sole",
        "link",
        (0.0, 0.0, -0.1),
        stiffness=40_000.0,
        damping=800.0,
        tangential_stiffness=20_000.0,
        tangential_damping=100.0,
        friction=friction,
        patch_radius=patch,
        integration=integration,
    )
    # Round and low, so that it stands on its one point while it spins.
    body = free_link(5.0, diagonal(0.2, 0.2, 0.3), [site], height=0.1)
    limit = 2.0 / 3.0 * patch * friction * 5.0 * GRAVITY
    q = np.tile(body.q_reference, (4, 1))
    q[:, 2] -= 5.0 * GRAVITY / 40_000.0
    u = np.zeros((4, 6))
    u[0, 5] = 6.0  # spins down
    flight = start(Pulled(body), q, u)
    flight.engine.set_parameter("turn_z", np.array([0.0, 0.45 * limit, 1.5 * limit, -1.5 * limit]))
    flight.advance(6)
    early = flight.u[:, 5]
    flight.advance(6)
    rate = (flight.u[:, 5] - early) / 0.2
    assert rate[0] == pytest.approx(-limit / 0.3, rel=0.01)
    assert rate[2] == pytest.approx(0.5 * limit / 0.3, rel=0.01)
    assert rate[3] == pytest.approx(-0.5 * limit / 0.3, rel=0.01)
    flight.advance(48)
    assert np.max(np.abs(flight.u[:2, 5])) < 0.05
    # The patch's spring bears the second's moment at this twist.
    assert 2.0 * np.arcsin(flight.q[1, 5]) == pytest.approx(0.45 * limit / (20_000.0 * patch**2), rel=0.02)


# ---- walls -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("integration", BOTH)
def test_a_wall_stops_a_ball_and_bears_a_push(integration: Integration):
    radius = 0.2
    wall: dict[str, Any] = {"tangential_stiffness": 0.0, "friction": 0.3, "integration": integration}
    bumper = ContactSite(
        "bumper",
        "link",
        (0.0, 0.0, 0.0),
        radii=(radius, radius, radius),
        surface="wall",
        stiffness=8000.0,
        damping=100.0,
        **wall,
    )
    base = ball_body(radius, stiffness=40_000.0, damping=400.0, friction=0.0)
    body = replace(base, contacts=(*base.contacts, bumper))
    q = np.tile(body.q_reference, (3, 1))
    q[:, 2] -= body.mass * GRAVITY / 40_000.0
    u = np.zeros((3, 6))
    u[:, 0], u[1, 1] = (2.0, 2.0, 0.0), 1.0
    flight = start(Pulled(body), q, u, wall_at=1.0)
    flight.engine.set_parameter("pull_x", np.array([0.0, 0.0, 40.0]))
    farthest = np.zeros(3)
    for _ in range(120):
        farthest = np.maximum(farthest, flight.advance(1).q[:, 0])
    assert np.all(farthest > 1.0 - radius)
    assert np.all(farthest < 1.0 - radius + 0.08)
    # Two came straight or askance and were sent back, slower; one leans against it.
    assert np.all(flight.u[:2, 0] < -0.3)
    assert np.all(flight.u[:2, 0] > -2.0)
    assert flight.q[2, 0] == pytest.approx(1.0 - radius + 40.0 / 8000.0, abs=2e-4)
    # Friction along the wall took from the sliding speed, and no more than its share of the normal impulse.
    lost = 1.0 - flight.u[1, 1]
    assert lost > 0.1
    assert lost <= 0.3 * (2.0 - flight.u[1, 0]) * 1.01


# ---- sites that are rarely touched -----------------------------------------------------------------------------------
@pytest.mark.parametrize("integration", BOTH)
def test_rare_sites_give_the_very_bits_of_usual_ones(integration: Integration):
    """Sixteen blocks on two corners, some dropped, some aloft: skipping what nobody touches changes nothing."""
    rng = np.random.default_rng(31)
    settings: dict[str, Any] = {"damping": 150.0, "tangential_damping": 150.0, "patch_radius": 0.02}
    usual = block_body(stiffness=20_000.0, integration=integration, **settings)
    usual = replace(usual, contacts=usual.contacts[1:3])
    rare = replace(usual, contacts=tuple(replace(site, use="rare") for site in usual.contacts))
    q = np.tile(usual.q_reference, (16, 1))
    q[:, 2] += rng.uniform(-0.005, 0.1, size=16)
    q[12:, 2] += 9.0
    q[:, 3:6] = rng.uniform(-0.1, 0.1, size=(16, 3))
    q, u = as_float32(usual.normalized(q)), as_float32(0.5 * rng.normal(size=(16, 6)))
    flights = [start(passive(body), q, u, angle=0.1) for body in (usual, rare)]
    for _ in range(12):
        a, b = (flight.advance(1).engine.full_state() for flight in flights)
        for key in ("state", "origins"):
            assert a[key].tobytes() == b[key].tobytes()


def runs_of(values: Sequence[bool]) -> int:
    """How often a condition begins to hold."""
    return int(np.count_nonzero(np.diff(np.array([False, *values]).astype(int)) == 1))


def test_a_bouncing_ball_touches_once_a_bounce():
    """The load is positive in one stretch a bounce: no chatter at touchdown or liftoff."""
    body = ball_body(stiffness=20_000.0, damping=30.0)
    q = body.q_reference.copy()
    q[2] += 0.04
    run = ReferenceRun(passive(body), q[None], np.zeros((1, 6)), step=STEP)
    loads, dented = [], []
    for _ in range(360):
        forces, _, _ = site_forces(run)
        loads.append(bool(forces[0][0] > 0.0))
        dented.append(bool(run.state.q[2][0] < 0.2))
        run.substep()
    assert runs_of(loads) == runs_of(dented) >= 2
