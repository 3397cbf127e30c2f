"""Stages of rides: the road, what is on and beside it, the cameras, and what the validators say."""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation

from echelon.export import scenery_assets
from echelon.export.displayed_ground import DisplayedGround
from echelon.export.drawn_parts import parts_of
from echelon.export.physics import write_physics
from echelon.export.road_scene import PAINT_LIFT, TOLERANCE, RoadScene, road_scene
from echelon.export.stage.motion import angular_velocities
from echelon.export.usd import Representation, write_stage
from echelon.terrain.roadside import SIZES, place_roadside
from tests.export.road_ride import cyclist, ride_recording, small_course
from tests.export.stage_validation import nvidia_issues, usd_errors

ROOT = "/small_ride"
OBSTACLES = (
    {"kind": "car", "distance": 90.0, "offset": -2.5},
    {"kind": "barrier", "distance": 120.0, "offset": 2.0, "length": 4.0, "width": 1.2},
    {"kind": "jogger", "distance": 70.0, "offset": -3.2, "speed": 2.8},
)


@pytest.fixture(scope="module")
def ride() -> Any:
    return ride_recording(3, 12, obstacles=OBSTACLES)


@pytest.fixture(scope="module")
def scene(ride: Any) -> RoadScene:
    return road_scene(ride.world)


@pytest.fixture(scope="module")
def path(ride: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage(ride, tmp_path_factory.mktemp("ride") / "ride.usd")


@pytest.fixture(scope="module")
def stage(path: Path) -> Any:
    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize("representation", get_args(Representation))
def test_validators_find_nothing(ride: Any, tmp_path: Path, representation: Any) -> None:
    path = write_stage(ride, tmp_path / "ride.usd", representation)
    assert usd_errors(Usd.Stage.Open(str(path))) == []
    assert nvidia_issues(path) == []


def test_kinds_materials_and_normals(stage: Any) -> None:
    kinds = {str(p.GetPath())[len(ROOT) :]: Usd.ModelAPI(p).GetKind() for p in stage.Traverse() if p.GetKind()}
    assert kinds[""] == "assembly"
    for group in ("/World", "/World/Roadside", "/World/Obstacles", "/Crowd", "/Actors"):
        assert kinds[group] == "group", group
    components = {"/World/Road", "/World/Land", "/World/Obstacles/car_1", "/World/Obstacles/barrier_1", "/Actors/user"}
    components |= {f"/World/Roadside/{kind}s" for kind in ("house", "tree", "lamp", "hydrant")}
    for component in components:
        assert kinds[component] == "component", component
    everything = Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
    meshes = [UsdGeom.Mesh(prim) for prim in everything if prim.IsA(UsdGeom.Mesh)]
    assert len(meshes) > 40
    for mesh in meshes:
        assert UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0], mesh.GetPath()
        assert UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals").HasAuthoredValue()
        low, high = np.array(mesh.GetExtentAttr().Get())
        points = np.array(mesh.GetPointsAttr().Get())
        assert np.allclose([points.min(axis=0), points.max(axis=0)], [low, high])
        assert mesh.GetPurposeAttr().Get() == UsdGeom.Tokens.default_


def test_ground_is_where_the_course_has_it(stage: Any) -> None:
    """Every part but the land within the tolerance of the surface that wheels feel, with what is laid upon it."""
    course = small_course()
    for name, lift, tolerance in (
        ("Road/asphalt", 0.0, 1e-3), ("Road/verge", 0.0, 0.05), ("Road/paint", PAINT_LIFT, 1.5 * TOLERANCE),
        ("Land/land", 0.0, 0.05),
    ):  # fmt: skip
        points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath(f"{ROOT}/World/{name}")).GetPointsAttr().Get())
        height = course.surfaces.height(points[:, :2].astype(np.float64))
        assert np.abs(points[:, 2] - lift - height).max() < tolerance, name
    asphalt = UsdGeom.Mesh(stage.GetPrimAtPath(f"{ROOT}/World/Road/asphalt"))
    s, offset = course.centreline.closest(np.array(asphalt.GetPointsAttr().Get())[:, :2].astype(np.float64))
    assert np.abs(offset).max() == pytest.approx(course.half_width, abs=0.01)
    st = np.array(UsdGeom.PrimvarsAPI(asphalt).GetPrimvar("st").ComputeFlattened())
    assert np.allclose(st[:, 0], 0.5 - 0.5 * offset / course.half_width, atol=0.01)
    along = np.abs(st[:, 1] - s)
    assert np.minimum(along, course.length - along).max() < 0.1


def test_paint_lies_on_the_triangles_that_are_drawn(scene: RoadScene) -> None:
    parts = {part.name: part.mesh for part in scene.ground}
    ground = DisplayedGround(parts["asphalt"].points[parts["asphalt"].triangles].astype(np.float64))
    paint = parts["paint"]
    middles = paint.points[paint.triangles].astype(np.float64).mean(axis=1)
    above = middles[:, 2] - ground.heights(middles)
    assert above.min() > 0.2 * PAINT_LIFT
    assert above.max() < 3.0 * PAINT_LIFT
    area = np.linalg.norm(
        np.cross(*np.diff(paint.points[paint.triangles].astype(float), axis=1).swapaxes(0, 1)), axis=1
    )
    # Two edge lines all along, and dashes in the middle of a third of the way.
    length = small_course().length
    assert 0.5 * area.sum() == pytest.approx((2.0 + 1.0 / 3.0) * 0.12 * length + 0.4 * 8.0, rel=0.03)


def test_side_streets_end_at_the_road(scene: RoadScene) -> None:
    streets = next(part.mesh for part in scene.ground if part.name == "streets")
    middles = streets.points[streets.triangles].astype(np.float64).mean(axis=1)
    _, offset = small_course().centreline.closest(middles[:, :2])
    assert np.abs(offset).min() > small_course().half_width - 1.6
    assert (np.abs(offset) < small_course().half_width + 1.0).any(), "they do not reach the road"
    course = small_course()
    above = streets.points[:, 2] - course.surfaces.height(streets.points[:, :2].astype(np.float64))
    assert np.abs(above).max() < 0.6
    assert np.median(above) > 0.0


def test_scenery_is_instanced_where_the_course_placed_it(stage: Any) -> None:
    placed = place_roadside(small_course())
    count = 0
    for kind, placement in placed.items():
        instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"{ROOT}/World/Roadside/{kind}s"))
        matrices = np.array([np.array(m) for m in instancer.ComputeInstanceTransformsAtTime(0.0, 0.0)])
        assert np.allclose(matrices[:, 3, :3], placement.positions, atol=1e-4)
        assert np.allclose(np.linalg.norm(matrices[:, :3, :3], axis=2), placement.scales, rtol=1e-4)
        ahead = matrices[:, 0, :2] / np.linalg.norm(matrices[:, 0, :2], axis=1, keepdims=True)
        assert np.allclose(ahead, np.column_stack([np.cos(placement.yaws), np.sin(placement.yaws)]), atol=1e-3)
        extent = np.array(instancer.GetExtentAttr().Get())
        exact = np.array(instancer.ComputeExtentAtTime(0.0, 0.0))
        assert (extent[0] <= exact[0] + 1e-4).all()
        assert (extent[1] >= exact[1] - 1e-4).all()
        colors = UsdGeom.PrimvarsAPI(instancer).GetPrimvar("displayColor").ComputeFlattened()
        assert len(colors) == len(placement)
        count += len(placement)
    assert count > 40
    # Geometry is written once: nothing that is drawn beside the road has points of its own.
    for prim in Usd.PrimRange(stage.GetPrimAtPath(f"{ROOT}/World/Roadside")):
        if prim.IsA(UsdGeom.Mesh):
            assert "/Assets/" in str(prim.GetPrimStack()[-1].path)


def test_obstacles_stand_on_the_road(stage: Any) -> None:
    course = small_course()
    for name, s, offset, length in (("car_1", 90.0, -2.5, 4.4), ("barrier_1", 120.0, 2.0, 4.0)):
        prim = stage.GetPrimAtPath(f"{ROOT}/World/Obstacles/{name}")
        matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
        found_s, found_offset = course.centreline.closest(matrix[None, 3, :2])
        assert found_s[0] == pytest.approx(s, abs=0.1)
        assert found_offset[0] == pytest.approx(offset, abs=0.05)
        assert matrix[3, 2] == pytest.approx(float(course.surfaces.height(matrix[None, 3, :2])[0]), abs=0.04)
        assert matrix[0, :3] @ course.centreline.tangent(s) > 0.999
        assert stage.GetPrimAtPath(f"{ROOT}/World/Obstacles/{name}/geometry").IsInstance()
        bounds = UsdGeom.BBoxCache(0.0, [UsdGeom.Tokens.default_]).ComputeUntransformedBound(prim)
        size = bounds.ComputeAlignedRange().GetSize()
        assert size[0] == pytest.approx(length, abs=0.45)
        assert size[2] > 0.9
    assert not stage.GetPrimAtPath(f"{ROOT}/World/Obstacles/jogger_1"), "joggers are actors and move"


def test_actors_look_like_what_they_are(stage: Any, ride: Any) -> None:
    cache = UsdGeom.BBoxCache(0.0, [UsdGeom.Tokens.default_])
    heights = {}
    for index, name in enumerate(("user", "jogger")):
        prim = stage.GetPrimAtPath(f"{ROOT}/Actors/{name}")
        box = cache.ComputeUntransformedBound(prim).ComputeAlignedRange()
        heights[name] = box.GetMax()[2]
        assert box.GetMin()[2] == pytest.approx(0.0, abs=0.02)
        assert box.GetMax()[1] == pytest.approx(-box.GetMin()[1], abs=0.02)
        matrix = np.array(UsdGeom.XformCache(7.0).GetLocalToWorldTransform(prim))
        assert np.allclose(matrix[3, :3], ride.actor_poses[7, index, :3])
    assert 1.6 < heights["user"] < 1.9
    assert 1.7 < heights["jogger"] < 1.9


def test_cameras_see_the_group(stage: Any, ride: Any) -> None:
    for name in ("follow", "roadside", "helicopter"):
        camera = UsdGeom.Camera(stage.GetPrimAtPath(f"{ROOT}/Cameras/{name}"))
        for frame in (0, 6, 11):
            view = camera.GetCamera(float(frame))
            frustum = view.frustum
            middle = ride.link_poses[frame, :, 0, :3].mean(axis=0) + [0.0, 0.0, 0.9]
            assert frustum.Intersects(Gf.Vec3d(*middle.tolist())), (name, frame)
            height = small_course().surfaces.height(np.array([view.transform.ExtractTranslation()[:2]]))[0]
            assert view.transform.ExtractTranslation()[2] > height + 0.8
    eyes = UsdGeom.Xformable(stage.GetPrimAtPath(f"{ROOT}/Cameras/roadside")).GetOrderedXformOps()[0]
    assert eyes.GetNumTimeSamples() == 0, "a camera that stands still is sampled"


def test_wheels_turn_the_right_way_between_samples(stage: Any) -> None:
    """A wheel at 8 m/s turns by 46 degrees a frame; half way between two it has turned by half of that."""
    wheel = stage.GetPrimAtPath(f"{ROOT}/Crowd/cyclist_000/frame/rear_wheel")
    turns = []
    for time in (4.0, 4.5, 5.0):
        matrix = np.array(UsdGeom.Xformable(wheel).GetLocalTransformation(time))
        turns.append(Rotation.from_matrix(matrix[:3, :3].T))
    step = 8.0 / 30.0 / cyclist().bicycle.rear_wheel.radius
    for first, second in ((0, 1), (1, 2)):
        between = (turns[second] * turns[first].inv()).as_rotvec()
        assert np.allclose(between, [0.0, 0.5 * step, 0.0], atol=0.02)


def test_fast_wheels_do_not_seem_to_turn_back() -> None:
    """At 16 m/s a wheel turns by 1.6 rad a frame: more than half a turn in two frames."""
    angles = 1.6 * np.arange(6)
    found = angular_velocities(Rotation.from_rotvec(angles[:, None] * [0.0, 1.0, 0.0]).as_quat()[:, None], 30)
    assert np.allclose(found[:, 0], [0.0, 48.0, 0.0])


# ---- assets --------------------------------------------------------------------------------------------------------
def every_asset() -> dict[str, Any]:
    found = {name: scenery_assets.asset(name) for names in scenery_assets.VARIANTS.values() for name in names}
    found["car"] = scenery_assets.obstacle("car", 4.4, 1.8)
    found["barrier"] = scenery_assets.obstacle("barrier", 6.0, 1.5)
    found["jogger"] = parts_of(scenery_assets.jogger_visuals())
    return found


@pytest.mark.parametrize("name", sorted(every_asset()))
def test_faces_of_assets_look_outwards(name: str) -> None:
    for part in every_asset()[name]:
        a, b, c = (part.mesh.points[part.mesh.triangles[:, corner]].astype(float) for corner in range(3))
        faces = np.cross(b - a, c - a)
        normals = part.mesh.normals[part.mesh.triangles].mean(axis=1)
        areas = np.linalg.norm(faces, axis=1)
        assert ((faces * normals).sum(axis=1)[areas > 1e-9] > 0.0).all()
        assert np.allclose(np.linalg.norm(part.mesh.normals, axis=1), 1.0, atol=1e-5)


def test_assets_are_simple_and_of_the_sizes_that_the_roadside_keeps_free() -> None:
    for kind, names in scenery_assets.VARIANTS.items():
        for name in names:
            parts = scenery_assets.asset(name)
            assert sum(len(part.mesh.triangles) for part in parts) < 260
            extent = np.array([part.mesh.extent for part in parts])
            low, high = extent[:, 0].min(axis=0), extent[:, 1].max(axis=0)
            size = np.array(SIZES[kind])
            assert high[2] == pytest.approx(size[2], abs=0.6)
            if kind != "lamp":
                assert (np.maximum(high, -low)[:2] < 0.5 * size[:2] + 0.5).all(), name


def test_ground_above_ground_is_told_apart_by_height() -> None:
    square = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]])
    low, high = np.column_stack([square, np.zeros(3)]), np.column_stack([square, [5.0, 5.0, 5.9]])
    ground = DisplayedGround(np.stack([low, high]))
    heights = ground.heights(np.array([[6.0, 3.0, 1.0], [6.0, 3.0, 6.0], [-5.0, 3.0, 2.5]]))
    assert np.allclose(heights, [0.0, 5.3, 2.5])
    planes = ground.planes(np.array([[6.0, 3.0, 6.0]]))
    assert np.allclose(planes[0, :3] @ high.T, planes[0, 3])


# ---- physics -------------------------------------------------------------------------------------------------------
def test_physics_of_a_rider(ride: Any, tmp_path: Path) -> None:
    path = write_physics(ride, tmp_path / "ride.usd", frame=6)
    stage = Usd.Stage.Open(str(path))
    assert usd_errors(stage) == []
    assert nvidia_issues(path) == []
    body = cyclist().body
    root = f"{ROOT}/Crowd/cyclist_001"
    masses = [UsdPhysics.MassAPI(stage.GetPrimAtPath(f"{root}/{link.name}")).GetMassAttr().Get() for link in body.links]
    assert sum(masses) == pytest.approx(body.mass, rel=1e-5)
    springs = stage.GetPrimAtPath(f"{root}/springs").GetChildren()
    assert len(springs) == len(body.springs) == 4
    for prim, spring in zip(springs, body.springs, strict=True):
        joint = UsdPhysics.Joint(prim)
        ends = [str(rel.GetTargets()[0]) for rel in (joint.GetBody0Rel(), joint.GetBody1Rel())]
        assert ends == [f"{root}/{spring.link_a}", f"{root}/{spring.link_b}"]
        assert joint.GetExcludeFromArticulationAttr().Get()
        sites = []
        for end, local in zip(ends, (joint.GetLocalPos0Attr().Get(), joint.GetLocalPos1Attr().Get()), strict=True):
            to_world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(end)))
            sites.append(np.array([*local, 1.0]) @ to_world)
        assert np.linalg.norm(sites[0] - sites[1]) < 0.01, "hands are on the bars and feet on the pedals"
        for axis in ("transX", "transY", "transZ"):
            drive = UsdPhysics.DriveAPI(prim, axis)
            assert drive.GetStiffnessAttr().Get() == pytest.approx(spring.stiffness)
            assert drive.GetDampingAttr().Get() == pytest.approx(spring.damping)
    wheel = stage.GetPrimAtPath(f"{root}/joints/rear_wheel")
    assert wheel.IsA(UsdPhysics.RevoluteJoint)
    assert not np.isfinite(UsdPhysics.RevoluteJoint(wheel).GetUpperLimitAttr().Get())
    rate = np.degrees(8.0 / cyclist().bicycle.rear_wheel.radius)
    assert wheel.GetAttribute("state:angular:physics:velocity").Get() == pytest.approx(rate, rel=0.02)
    ground = UsdPhysics.CollisionGroup(stage.GetPrimAtPath(f"{ROOT}/groups/ground"))
    names = [target.name for target in ground.GetCollidersCollectionAPI().GetIncludesRel().GetTargets()]
    assert sorted(names) == ["asphalt", "land", "verge"]
    car = stage.GetPrimAtPath(f"{ROOT}/World/car_1")
    assert UsdPhysics.MeshCollisionAPI(car).GetApproximationAttr().Get() == UsdPhysics.Tokens.convexHull
