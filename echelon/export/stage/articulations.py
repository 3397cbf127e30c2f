"""A cast's body as a UsdPhysics articulation: rigid bodies side by side, joints between them, colliders at its sites.

The asset stands under ``Assets`` as ``<cast>_articulation`` and every agent references it, so masses and joints are
written once. Rigid bodies may not be nested, hence the links are siblings.

A spring of no length between two links (hand to bar, foot to pedal) becomes a joint that locks nothing and pulls in
three directions: a drive along each axis has the spring's stiffness and damping. It closes a loop and so is no part of
the articulation.

What another engine cannot know from it: servos, springs that have a length, the stiffness of contacts and limits, and
whatever a controller couples, such as a chain. They are the simulation's own.
"""

# pyright: reportAttributeAccessIssue=false
# USD's modules are compiled and come without stubs.
from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from echelon.export.shapes import visual_mesh
from echelon.export.stage.characters import GEOMETRY, link_names, links_path, reference_origins
from echelon.export.stage.joints import LINEAR_FREEDOMS, PhysicsJoint, physics_joint, principal_inertia
from echelon.export.stage.meshes import define_mesh, welded
from echelon.export.stage.motion import prim_names
from echelon.warp_kernels.model import ContactSite, Link, Model, Spring, Visual

JOINTS = "joints"
SPRINGS = "springs"
# UsdPhysics takes a mass or moment of zero for "work it out from the colliders".
LEAST_MASS = 1e-6  # [kg]
LEAST_MOMENT = 1e-9  # [kg m^2]
POINT_RADIUS = 1e-3  # [m] of the ball that stands for a contact point


def articulation_path(assets: Sdf.Path, cast: str) -> Sdf.Path:
    return assets.AppendChild(f"{cast}_articulation")


def joint_names(body: Model) -> tuple[str, ...]:
    """Prim names of the joints, one a link, free joints included."""
    return prim_names([link.joint.name for link in body.links])


def site_paths(body: Model) -> tuple[str, ...]:
    """Where each contact site's collider stands in an articulation, relative to it."""
    links = dict(zip(body.link_names, link_names(body), strict=True))
    names = prim_names([f"contact_{site.name}" for site in body.contacts])
    return tuple(f"{links[site.link]}/{name}" for site, name in zip(body.contacts, names, strict=True))


def physics_joints(body: Model) -> tuple[PhysicsJoint | None, ...]:
    """How each link's joint is written; None for free joints, which are not."""
    return tuple(
        None
        if link.joint.kind == "free"
        else physics_joint(link.joint, f"body {body.name!r}, joint {link.joint.name!r}")
        for link in body.links
    )


def define_articulation(
    stage: Usd.Stage, assets: Sdf.Path, cast: str, body: Model, materials: Mapping[float, UsdShade.Material]
) -> None:
    """Define a cast's articulation in the reference pose.

    Args:
        stage: The stage.
        assets: Where the character assets are; the geometry of the links is there already.
        cast: The cast's prim name.
        body: Its body.
        materials: Physics material for each coefficient of friction among its contact sites.
    """
    path = articulation_path(assets, cast)
    root = stage.CreateClassPrim(path)
    root.SetTypeName("Xform")
    UsdPhysics.ArticulationRootAPI.Apply(root)
    paths = [path.AppendChild(name) for name in link_names(body)]
    for index, (link, origin) in enumerate(zip(body.links, reference_origins(body).tolist(), strict=True)):
        prim = _define_link(stage, paths[index], link, origin)
        # Links of one body pass through one another in the simulation.
        if paths[index + 1 :]:
            UsdPhysics.FilteredPairsAPI.Apply(prim).CreateFilteredPairsRel().SetTargets(paths[index + 1 :])
        if link.visuals:
            geometry = UsdGeom.Xform.Define(stage, paths[index].AppendChild(GEOMETRY)).GetPrim()
            geometry.GetReferences().AddInternalReference(links_path(assets, cast).AppendChild(link_names(body)[index]))
            geometry.SetInstanceable(True)
    for site, site_path in zip(body.contacts, site_paths(body), strict=True):
        _define_collider(stage, path.AppendPath(site_path), site, materials[site.friction])
    UsdGeom.Scope.Define(stage, path.AppendChild(JOINTS))
    for index, (name, joint) in enumerate(zip(joint_names(body), physics_joints(body), strict=True)):
        if joint is not None:
            parent = body.parents[index]
            _define_joint(
                stage,
                path.AppendChild(JOINTS).AppendChild(name),
                body.links[index],
                joint,
                paths[parent] if parent >= 0 else None,
                paths[index],
            )

    if any(spring.rest_length == 0.0 for spring in body.springs):
        UsdGeom.Scope.Define(stage, path.AppendChild(SPRINGS))
    links = dict(zip(body.link_names, paths, strict=True))
    for name, spring in zip(prim_names([spring.name for spring in body.springs]), body.springs, strict=True):
        if spring.rest_length == 0.0:
            _define_spring(stage, path.AppendChild(SPRINGS).AppendChild(name), spring, links)


def _define_spring(stage: Usd.Stage, path: Sdf.Path, spring: Spring, links: Mapping[str, Sdf.Path]) -> None:
    """A bushing: nothing is locked, a drive along each axis pulls the two sites together."""
    joint = UsdPhysics.Joint.Define(stage, path)
    # An end without a link is fixed in the world.
    if spring.link_a is not None:
        joint.CreateBody0Rel().SetTargets([links[spring.link_a]])
    if spring.link_b is not None:
        joint.CreateBody1Rel().SetTargets([links[spring.link_b]])
    joint.CreateLocalPos0Attr(Gf.Vec3f(*spring.position_a))
    joint.CreateLocalPos1Attr(Gf.Vec3f(*spring.position_b))
    joint.CreateLocalRot0Attr(Gf.Quatf(1.0))
    joint.CreateLocalRot1Attr(Gf.Quatf(1.0))
    joint.CreateExcludeFromArticulationAttr(True)
    for axis in LINEAR_FREEDOMS:
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), axis)
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateTargetPositionAttr(0.0)
        drive.CreateStiffnessAttr(spring.stiffness)
        drive.CreateDampingAttr(spring.damping)


def _define_link(stage: Usd.Stage, path: Sdf.Path, link: Link, origin: list[float]) -> Usd.Prim:
    xform = UsdGeom.Xform.Define(stage, path)
    xform.AddTranslateOp().Set(Gf.Vec3d(*origin))
    xform.AddOrientOp().Set(Gf.Quatf(1.0))
    prim = xform.GetPrim()
    body = UsdPhysics.RigidBodyAPI.Apply(prim)
    body.CreateVelocityAttr(Gf.Vec3f(0.0))
    body.CreateAngularVelocityAttr(Gf.Vec3f(0.0))
    moments, axes = principal_inertia(link.inertia)
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(max(link.mass, LEAST_MASS))
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*link.com))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*np.maximum(moments, LEAST_MOMENT).tolist()))
    mass.CreatePrincipalAxesAttr(quatf(axes))
    return prim


def _define_collider(stage: Usd.Stage, path: Sdf.Path, site: ContactSite, material: UsdShade.Material) -> None:
    """A ball where the site is round or a point, otherwise the hull of an ellipsoid; not drawn."""
    radii = np.maximum(site.radii, POINT_RADIUS)
    if np.ptp(radii) < 1e-9:
        sphere = UsdGeom.Sphere.Define(stage, path)
        radius = float(radii[0])
        sphere.CreateRadiusAttr(radius)
        sphere.CreateExtentAttr([Gf.Vec3f(-radius), Gf.Vec3f(radius)])
        sphere.AddTranslateOp().Set(Gf.Vec3d(*site.position))
    else:
        size = (float(radii[0]), float(radii[1]), float(radii[2]))
        mesh = define_mesh(stage, str(path), welded([visual_mesh(Visual("ellipsoid", size, site.position))]))
        collision = UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim())
        collision.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
    make_collider(stage.GetPrimAtPath(path), material)
    UsdGeom.Imageable(stage.GetPrimAtPath(path)).CreatePurposeAttr(UsdGeom.Tokens.guide)


def make_collider(prim: Usd.Prim, material: UsdShade.Material) -> None:
    """Let other things bump into a prim's geometry, with a physics material."""
    UsdPhysics.CollisionAPI.Apply(prim)
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")


def _define_joint(
    stage: Usd.Stage,
    path: Sdf.Path,
    link: Link,
    joint: PhysicsJoint,
    inboard: Sdf.Path | None,
    outboard: Sdf.Path,
) -> None:
    schemas = {
        "revolute": UsdPhysics.RevoluteJoint,
        "prismatic": UsdPhysics.PrismaticJoint,
        "spherical": UsdPhysics.SphericalJoint,
        "d6": UsdPhysics.Joint,
    }
    prim = schemas[joint.schema].Define(stage, path)
    if inboard is not None:
        prim.CreateBody0Rel().SetTargets([inboard])
    prim.CreateBody1Rel().SetTargets([outboard])
    prim.CreateLocalPos0Attr(Gf.Vec3f(*link.joint.position))
    prim.CreateLocalRot0Attr(quatf(joint.frame))
    prim.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    prim.CreateLocalRot1Attr(quatf(joint.frame))
    if joint.schema == "d6":
        for name, (low, high) in zip(joint.freedoms, joint.limits, strict=True):
            _limit(prim.GetPrim(), name, float(np.degrees(low)), float(np.degrees(high)))
        for name in joint.locked:
            _limit(prim.GetPrim(), name, 1.0, -1.0)
        return
    prim.CreateAxisAttr(UsdPhysics.Tokens.x)
    for low, high in joint.limits:
        scale = 1.0 if joint.schema == "prismatic" else float(np.degrees(1.0))
        prim.CreateLowerLimitAttr(scale * low)
        prim.CreateUpperLimitAttr(scale * high)


def _limit(prim: Usd.Prim, freedom: str, low: float, high: float) -> None:
    limit = UsdPhysics.LimitAPI.Apply(prim, freedom)
    limit.CreateLowAttr(low)
    limit.CreateHighAttr(high)


def quatf(q: np.ndarray) -> Gf.Quatf:
    """A quaternion (x, y, z, w) as USD's."""
    x, y, z, w = (float(part) for part in q)
    return Gf.Quatf(w, x, y, z)
