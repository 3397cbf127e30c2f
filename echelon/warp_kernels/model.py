"""A body as data: links, joints, springs, contact sites.

Frames
------
Every link has a frame whose origin is its inboard joint and whose axes are
parallel to its parent's when the joint's coordinates are zero. In the
*reference pose* (all coordinates zero) every link frame is therefore parallel
to the world's: x forward, y left, z up. Positions inside a link (centre of
mass, outboard joints, sites, visuals) are written in that link's frame, in
metres.

Coordinates
-----------
The generalised positions ``q`` and speeds ``u`` follow the links in order:

=========  ==========================  =============================================
joint      q                           u
=========  ==========================  =============================================
free       x y z, quaternion x y z w   velocity of the origin in the world frame,
                                       angular velocity in the link's own frame
ball       quaternion x y z w          angular velocity relative to the parent, in
                                       the link's own frame
pin        angle                       its rate
universal  two angles, about axes that its two rates
           turn, inboard to outboard
gimbal     three angles, likewise      its three rates
slider     displacement along the axis its rate
=========  ==========================  =============================================

``u`` of a free or ball joint is an angular velocity, not the rate of its
quaternion, so ``len(u) <= len(q)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal, Self, TypeVar, get_args

import numpy as np

from echelon.errors import InputError

Vec3 = tuple[float, float, float]
Matrix3 = tuple[Vec3, Vec3, Vec3]
JointKind = Literal["free", "ball", "pin", "universal", "gimbal", "slider"]
VisualShape = Literal["ellipsoid", "capsule", "cylinder", "box", "torus", "mesh"]
Surface = Literal["ground", "wall"]
Integration = Literal["implicit", "explicit"]
Use = Literal["usual", "rare"]

AXIS_COUNT: Mapping[str, int] = {"free": 0, "ball": 0, "pin": 1, "universal": 2, "gimbal": 3, "slider": 1}
Q_COUNT: Mapping[str, int] = {"free": 7, "ball": 4, "pin": 1, "universal": 2, "gimbal": 3, "slider": 1}
U_COUNT: Mapping[str, int] = {"free": 6, "ball": 3, "pin": 1, "universal": 2, "gimbal": 3, "slider": 1}


# Fields of a contact site that have a size but no sign.
CONTACT_SIZES = (
    "radii",
    "stiffness",
    "damping",
    "tangential_stiffness",
    "tangential_damping",
    "friction",
    "patch_radius",
    "rolling_resistance",
)


class ModelError(InputError):
    """A body description that cannot be a body; the message is one line that says where and why."""


@dataclass(frozen=True)
class Joint:
    """How a link hangs on its parent.

    Attributes:
        name: Unique name of the joint.
        kind: One of free, ball, pin, universal, gimbal, slider.
        position: Origin of the link's frame in the parent's frame (in the world's for a root) [m].
        axes: Unit axes, inboard to outboard; each is fixed in the frame that the axes before it have turned.
        limits: For each axis None or (lower, upper) [rad or m], held by a spring and damper beyond them.
        limit_stiffness: [N m/rad or N/m].
        limit_damping: [N m s/rad or N s/m].
        continuous: For a pin that turns without end, like a wheel: its angle is taken back by two turns at the start
            of a frame in which it has left [-2 pi, 2 pi], so that it stays as precise as it was.
    """

    name: str
    kind: JointKind
    position: Vec3 = (0.0, 0.0, 0.0)
    axes: tuple[Vec3, ...] = ()
    limits: tuple[tuple[float, float] | None, ...] = ()
    limit_stiffness: float = 0.0
    limit_damping: float = 0.0
    continuous: bool = False


@dataclass(frozen=True)
class Visual:
    """A shape drawn on a link; it has no part in the dynamics.

    Attributes:
        shape: ellipsoid, capsule, cylinder, box, torus or mesh.
        size: Semi-axes of an ellipsoid or box; (radius, half length along z, unused) of a capsule or
            cylinder, whose half length leaves out a capsule's caps; (radius of the ring about z, radius of its
            round section, unused) of a torus [m]; factors along its axes of a mesh.
        position: Centre in the link's frame, of a mesh its origin [m].
        orientation: Quaternion (x, y, z, w) from the shape's axes to the link's.
        color: Linear RGB from 0 to 1, or None for the colour of the individual.
        points: Corners of a mesh [m]; it may be open, a patch of a surface.
        triangles: Corners of each of a mesh's triangles, counter-clockwise seen from outside. It is drawn smooth where
            neighbouring triangles meet at a gentle angle.
    """

    shape: VisualShape
    size: Vec3
    position: Vec3 = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    color: Vec3 | None = None
    points: tuple[Vec3, ...] = ()
    triangles: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True)
class Link:
    """A rigid link and the joint that carries it.

    Attributes:
        name: Unique name.
        parent: Name of the parent link, None for a root.
        joint: The inboard joint.
        mass: [kg].
        com: Centre of mass in the link's frame [m].
        inertia: Symmetric inertia tensor about the centre of mass, in the link's frame [kg m^2].
        visuals: Shapes to draw.
    """

    name: str
    parent: str | None
    joint: Joint
    mass: float
    com: Vec3 = (0.0, 0.0, 0.0)
    inertia: Matrix3 = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    visuals: tuple[Visual, ...] = ()


@dataclass(frozen=True)
class Spring:
    """A two-sided spring and damper between a site on one link and a site on another.

    With ``rest_length`` zero it is a bushing: the force is linear in the gap vector and its rate. Otherwise it acts
    along the line between the sites. A link name of None stands for the world; in plain data the empty string does,
    since TOML has no null.

    Attributes:
        stiffness: [N/m].
        damping: [N s/m].
        rest_length: [m].
    """

    name: str
    link_a: str | None
    position_a: Vec3
    link_b: str | None
    position_b: Vec3
    stiffness: float
    damping: float
    rest_length: float = 0.0


@dataclass(frozen=True)
class ContactSite:
    """A place on a link that can touch the ground or a wall.

    Attributes:
        position: Centre in the link's frame [m].
        radii: Semi-axes of the ellipsoid about it; three zeros for a point [m].
        surface: Which local plane it meets: the ground's or the nearest wall's.
        stiffness, damping: Along the normal [N/m], [N s/m].
        tangential_stiffness, tangential_damping: Of the sticking anchor [N/m], [N s/m].
        friction: Coulomb coefficient.
        patch_radius: Radius of the patch whose friction resists spinning about the normal; 0 for none [m].
        rolling_resistance: Lever arm by which the ground's support runs ahead of a rolling body: its moment is this
            times the load; 0 for none [m].
        integration: "implicit" takes stiffness and damping implicitly (see `contact`), for a stiff site under something
            light; "explicit" does not, which is cheaper and right where the mass behind the site is large enough for
            the step (see `stability`).
        use: "usual", or "rare" for a site that hardly ever touches: its arithmetic is skipped while nobody's does.
    """

    name: str
    link: str
    position: Vec3
    radii: Vec3 = (0.0, 0.0, 0.0)
    surface: Surface = "ground"
    stiffness: float = 50_000.0
    damping: float = 500.0
    tangential_stiffness: float = 50_000.0
    tangential_damping: float = 500.0
    friction: float = 0.9
    patch_radius: float = 0.0
    rolling_resistance: float = 0.0
    integration: Integration = "implicit"
    use: Use = "usual"


@dataclass(frozen=True)
class Model:
    """A whole body. Links stand after their parents; see the module's text for frames and coordinates.

    Attributes:
        name: Name of the body.
        links: Tree of links, parents first.
        springs: Springs and dampers between links.
        contacts: Sites that can touch the ground or a wall.
        gravity: Acceleration of gravity along -z [m/s^2].
    """

    name: str
    links: tuple[Link, ...]
    springs: tuple[Spring, ...] = ()
    contacts: tuple[ContactSite, ...] = ()
    gravity: float = 9.80665
    parents: tuple[int, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parents", _checked_parents(self))

    # ---- sizes and names -------------------------------------------------------------------------------------------
    @property
    def link_names(self) -> tuple[str, ...]:
        return tuple(link.name for link in self.links)

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """Names of the generalised positions, one for each entry of q."""
        return tuple(name for link in self.links for name in _coordinate_names(link.joint))

    @property
    def speed_names(self) -> tuple[str, ...]:
        """Names of the generalised speeds, one for each entry of u."""
        return tuple(name for link in self.links for name in _speed_names(link.joint))

    @property
    def q_count(self) -> int:
        return sum(Q_COUNT[link.joint.kind] for link in self.links)

    @property
    def u_count(self) -> int:
        return sum(U_COUNT[link.joint.kind] for link in self.links)

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return float(sum(link.mass for link in self.links))

    def link_index(self, name: str) -> int:
        """Index of a link by name; raises ModelError when there is none."""
        for index, link in enumerate(self.links):
            if link.name == name:
                return index
        raise ModelError(f"body {self.name!r}: no link {name!r}; links are {', '.join(self.link_names)}")

    def q_start(self, index: int) -> int:
        """Index in q of the first coordinate of link ``index``."""
        return sum(Q_COUNT[link.joint.kind] for link in self.links[:index])

    def u_start(self, index: int) -> int:
        """Index in u of the first speed of link ``index``."""
        return sum(U_COUNT[link.joint.kind] for link in self.links[:index])

    @property
    def q_reference(self) -> np.ndarray:
        """The reference pose: zeros, identity quaternions, a free root's joint position; shape [q_count]."""
        parts: list[float] = []
        for link in self.links:
            kind = link.joint.kind
            if kind == "free":
                parts += [*link.joint.position, 0.0, 0.0, 0.0, 1.0]
            elif kind == "ball":
                parts += [0.0, 0.0, 0.0, 1.0]
            else:
                parts += [0.0] * Q_COUNT[kind]
        return np.array(parts)

    # ---- plain data ------------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings that `Model.from_dict` and TOML or JSON understand: nothing is null."""
        data = asdict(self)
        del data["parents"]
        for spring in data["springs"]:
            for end in ("link_a", "link_b"):
                spring[end] = spring[end] or ""
        for visual in (visual for link in data["links"] for visual in link["visuals"]):
            for corners in ("points", "triangles"):
                if not visual[corners]:
                    del visual[corners]
        return _plain(data)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Build from plain data (parsed TOML or JSON); raises ModelError naming the key that is wrong."""
        if not isinstance(data, Mapping):
            raise ModelError(f"body: expected a table, found {data!r}")
        name = data.get("name", "body")
        where = f"body {name!r}"
        if not isinstance(name, str):
            raise ModelError(f"{where}: name is not a string")
        _check_keys(where, data, cls, leave_out=("parents",))
        links = tuple(_link(where, entry) for entry in _list(f"{where}, links", data.get("links", ())))
        springs = tuple(
            _spring(f"{where}, spring {i}", entry)
            for i, entry in enumerate(_list(f"{where}, springs", data.get("springs", ())))
        )
        contacts = tuple(
            _record(ContactSite, f"{where}, contact {i}", entry)
            for i, entry in enumerate(_list(f"{where}, contacts", data.get("contacts", ())))
        )
        gravity = _number(f"{where}, gravity", data.get("gravity", 9.80665))
        return cls(name=name, links=links, springs=springs, contacts=contacts, gravity=gravity)


def _coordinate_names(joint: Joint) -> list[str]:
    name = joint.name
    match joint.kind:
        case "free":
            return [f"{name}.{c}" for c in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        case "ball":
            return [f"{name}.{c}" for c in ("qx", "qy", "qz", "qw")]
        case "pin" | "slider":
            return [name]
        case _:
            return [f"{name}.{i + 1}" for i in range(AXIS_COUNT[joint.kind])]


def _speed_names(joint: Joint) -> list[str]:
    name = joint.name
    match joint.kind:
        case "free":
            return [f"{name}.{c}" for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
        case "ball":
            return [f"{name}.{c}" for c in ("wx", "wy", "wz")]
        case _:
            return _coordinate_names(joint)


# ---- checks --------------------------------------------------------------------------------------------------------
def _checked_parents(model: Model) -> tuple[int, ...]:
    """Check the whole model; return the index of each link's parent, -1 for a root."""
    where = f"body {model.name!r}"
    if not model.links:
        raise ModelError(f"{where}: needs at least one link")
    index_of: dict[str, int] = {}
    joint_names: set[str] = set()
    parents: list[int] = []
    all_names = {link.name for link in model.links}
    for index, link in enumerate(model.links):
        here = f"{where}, link {link.name!r}"
        if link.name in index_of:
            raise ModelError(f"{here}: this name is used twice")
        if link.joint.name in joint_names:
            raise ModelError(f"{here}: joint name {link.joint.name!r} is used twice")
        if link.parent is None:
            parents.append(-1)
        elif link.parent in index_of:
            parents.append(index_of[link.parent])
        elif link.parent in all_names:
            raise ModelError(f"{here}: parent {link.parent!r} stands after it, or they form a loop; parents come first")
        else:
            raise ModelError(f"{here}: parent {link.parent!r} is missing")
        index_of[link.name] = index
        joint_names.add(link.joint.name)
        _check_joint(here, link)
        _check_mass(here, link)
        for place, visual in enumerate(link.visuals):
            _check_corners(f"{here}, visual {place}", visual)
    for spring in model.springs:
        for end in (spring.link_a, spring.link_b):
            if end is not None and end not in index_of:
                raise ModelError(f"{where}, spring {spring.name!r}: link {end!r} is missing")
        _check_finite(f"{where}, spring {spring.name!r}", spring)
        _check_not_negative(f"{where}, spring {spring.name!r}", spring, ("stiffness", "damping", "rest_length"))
    for contact in model.contacts:
        if contact.link not in index_of:
            raise ModelError(f"{where}, contact {contact.name!r}: link {contact.link!r} is missing")
        if contact.surface not in get_args(Surface):
            raise ModelError(f"{where}, contact {contact.name!r}: surface {contact.surface!r} is not ground or wall")
        for key, allowed in (("integration", get_args(Integration)), ("use", get_args(Use))):
            if getattr(contact, key) not in allowed:
                raise ModelError(
                    f"{where}, contact {contact.name!r}: {key} {getattr(contact, key)!r} is not {' or '.join(allowed)}"
                )
        _check_finite(f"{where}, contact {contact.name!r}", contact)
        _check_not_negative(f"{where}, contact {contact.name!r}", contact, CONTACT_SIZES)
    if not np.isfinite(model.gravity):
        raise ModelError(f"{where}: gravity is {model.gravity}, not a finite number")
    _check_outboard_mass(where, model, parents)
    return tuple(parents)


def _check_joint(here: str, link: Link) -> None:
    joint = link.joint
    if joint.kind not in AXIS_COUNT:
        raise ModelError(f"{here}: joint kind {joint.kind!r} is not one of {', '.join(AXIS_COUNT)}")
    if joint.kind == "free" and link.parent is not None:
        raise ModelError(f"{here}: a free joint belongs to a root, but its parent is {link.parent!r}")
    if len(joint.axes) != AXIS_COUNT[joint.kind]:
        raise ModelError(f"{here}: a {joint.kind} joint has {AXIS_COUNT[joint.kind]} axes, not {len(joint.axes)}")
    if joint.limits and len(joint.limits) != len(joint.axes):
        raise ModelError(f"{here}: {len(joint.limits)} limits for {len(joint.axes)} axes")
    for axis in joint.axes:
        if not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
            raise ModelError(f"{here}: joint axis {list(axis)} is not a unit vector")
    if joint.continuous and (joint.kind != "pin" or any(joint.limits)):
        raise ModelError(f"{here}: only a pin without limits can be continuous")
    for limit in joint.limits:
        if limit is not None and not limit[0] < limit[1]:
            raise ModelError(f"{here}: joint limit {list(limit)} is not (lower, upper) with lower < upper")
    _check_finite(f"{here}, joint {joint.name!r}", joint)
    _check_not_negative(f"{here}, joint {joint.name!r}", joint, ("limit_stiffness", "limit_damping"))


def _check_mass(here: str, link: Link) -> None:
    _check_finite(here, link)
    if link.mass < 0.0:
        raise ModelError(f"{here}: mass is {link.mass} kg, must not be negative")
    inertia = np.array(link.inertia, dtype=float)
    if not np.all(np.isfinite(inertia)):
        raise ModelError(f"{here}: inertia holds a number that is not finite")
    if not np.allclose(inertia, inertia.T, rtol=0.0, atol=1e-12 + 1e-9 * float(np.abs(inertia).max())):
        raise ModelError(f"{here}: inertia is not symmetric")
    moments = np.linalg.eigvalsh(inertia)
    tolerance = 1e-9 * max(float(moments[-1]), 1e-300)
    if moments[0] < -tolerance:
        raise ModelError(f"{here}: inertia has a negative principal moment, {moments[0]:.6g} kg m^2")


def _check_corners(here: str, visual: Visual) -> None:
    """A mesh has points and triangles between them; nothing else has any."""
    if visual.shape != "mesh":
        if visual.points or visual.triangles:
            raise ModelError(f"{here}: only a mesh has points and triangles, shape is {visual.shape!r}")
        return
    if not visual.points or not visual.triangles:
        raise ModelError(f"{here}: a mesh needs points and triangles, found {len(visual.points)} points")
    if any(len(row) != 3 for row in (*visual.points, *visual.triangles)):
        raise ModelError(f"{here}: points are lists of 3 numbers, triangles lists of 3 points")
    if not np.all(np.isfinite(visual.points)):
        raise ModelError(f"{here}: points hold a number that is not finite")
    corners = np.array(visual.triangles)
    if corners.min() < 0 or corners.max() >= len(visual.points):
        raise ModelError(f"{here}: triangles name point {corners.max()}, there are {len(visual.points)}")


def _check_outboard_mass(where: str, model: Model, parents: Sequence[int]) -> None:
    """Every joint must carry mass, or its acceleration is undetermined."""
    outboard = [link.mass for link in model.links]
    for index in range(len(model.links) - 1, -1, -1):
        if not outboard[index] > 0.0:
            raise ModelError(f"{where}, link {model.links[index].name!r}: neither it nor what hangs on it has mass")
        if parents[index] >= 0:
            outboard[parents[index]] += outboard[index]


def _check_finite(here: str, record: Any) -> None:
    for entry in fields(record):
        value = getattr(record, entry.name)
        if isinstance(value, float | int) and not np.isfinite(value):
            raise ModelError(f"{here}: {entry.name} is {value}, not a finite number")
        if isinstance(value, tuple) and value and isinstance(value[0], float | int) and not np.all(np.isfinite(value)):
            raise ModelError(f"{here}: {entry.name} is {list(value)}, not finite numbers")


def _check_not_negative(here: str, record: Any, names: Sequence[str]) -> None:
    for name in names:
        value = getattr(record, name)
        if np.any(np.asarray(value) < 0.0):
            raise ModelError(f"{here}: {name} is {value}, must not be negative")


# ---- from plain data -----------------------------------------------------------------------------------------------
_Record = TypeVar("_Record", Joint, Visual, Spring, ContactSite)


def _check_keys(where: str, data: Mapping[str, Any], record: type, leave_out: tuple[str, ...] = ()) -> None:
    if not isinstance(data, Mapping):
        raise ModelError(f"{where}: expected a table, found {data!r}")
    known = [entry.name for entry in fields(record) if entry.name not in leave_out]
    for key in data:
        if key not in known:
            raise ModelError(f"{where}: unknown key {key!r}; known are {', '.join(known)}")


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, float | int) or not np.isfinite(value):
        raise ModelError(f"{where}: {value!r} is not a finite number")
    return float(value)


def _list(where: str, value: Any) -> Sequence[Any]:
    if isinstance(value, str | bytes) or not isinstance(value, Sequence):
        raise ModelError(f"{where}: {value!r} is not a list")
    return value


def _vector(where: str, value: Any) -> tuple[float, ...]:
    return tuple(_number(where, entry) for entry in _list(where, value))


def _record(record: type[_Record], where: str, data: Any) -> _Record:
    """Build one flat record: numbers, strings, vectors; the type's own defaults fill what is missing."""
    _check_keys(where, data, record)
    values: dict[str, Any] = {}
    for entry in fields(record):
        if entry.name not in data:
            continue
        value, kind, here = data[entry.name], str(entry.type), f"{where}, {entry.name}"
        if value is None and "None" in kind:
            values[entry.name] = None
        elif kind.startswith(("Vec3", "tuple[float")):
            values[entry.name] = _vector(here, value)
            size = 4 if kind.startswith("tuple[float, float, float, float]") else 3
            if len(values[entry.name]) != size:
                raise ModelError(f"{here}: expected {size} numbers, found {len(values[entry.name])}")
        elif kind == "float":
            values[entry.name] = _number(here, value)
        elif kind == "bool":
            if not isinstance(value, bool):
                raise ModelError(f"{here}: {value!r} is not true or false")
            values[entry.name] = value
        elif isinstance(value, str):
            values[entry.name] = value
        else:
            raise ModelError(f"{here}: {value!r} is not a string")
    try:
        return record(**values)
    except TypeError as error:
        missing = str(error).partition("argument")[2].strip(" s:")
        raise ModelError(f"{where}: missing {missing}") from None


def _link(where: str, data: Any) -> Link:
    if not isinstance(data, Mapping):
        raise ModelError(f"{where}: a link is a table, found {data!r}")
    here = f"{where}, link {data.get('name', '?')!r}"
    _check_keys(here, data, Link)
    for key in ("name", "joint", "mass"):
        if key not in data:
            raise ModelError(f"{here}: {key} is missing")
    if not isinstance(data["name"], str):
        raise ModelError(f"{here}: name is not a string")
    rows = _list(f"{here}, inertia", data.get("inertia", ((0.0,) * 3,) * 3))
    inertia = [_vector(f"{here}, inertia", row) for row in rows]
    if len(inertia) != 3 or any(len(row) != 3 for row in inertia):
        raise ModelError(f"{here}, inertia: expected three rows of three numbers")
    com = _vector(f"{here}, com", data.get("com", (0.0, 0.0, 0.0)))
    if len(com) != 3:
        raise ModelError(f"{here}, com: expected 3 numbers, found {len(com)}")
    parent = data.get("parent")
    if parent is not None and not isinstance(parent, str):
        raise ModelError(f"{here}, parent: {parent!r} is not a string")
    return Link(
        name=data["name"],
        parent=parent,
        joint=_joint(here, data["joint"]),
        mass=_number(f"{here}, mass", data["mass"]),
        com=(com[0], com[1], com[2]),
        inertia=tuple((row[0], row[1], row[2]) for row in inertia),  # type: ignore[arg-type]
        visuals=tuple(
            _visual(f"{here}, visual {i}", entry)
            for i, entry in enumerate(_list(f"{here}, visuals", data.get("visuals", ())))
        ),
    )


def _spring(where: str, data: Any) -> Spring:
    _check_keys(where, data, Spring)
    ends = {end: data[end] if data[end] != "" else None for end in ("link_a", "link_b") if end in data}
    return _record(Spring, where, {**data, **ends})


def _joint(here: str, data: Any) -> Joint:
    if not isinstance(data, Mapping):
        raise ModelError(f"{here}, joint: expected a table, found {data!r}")
    here = f"{here}, joint {data.get('name', '?')!r}"
    _check_keys(here, data, Joint)
    flat = {key: value for key, value in data.items() if key not in ("axes", "limits")}
    joint = _record(Joint, here, flat)
    axes = tuple(_vector(f"{here}, axes", axis) for axis in _list(f"{here}, axes", data.get("axes", ())))
    # TOML has no null: an axis without limits is an empty list there.
    pairs = _list(f"{here}, limits", data.get("limits", ()))
    limits = tuple(None if pair is None else _vector(f"{here}, limits", pair) or None for pair in pairs)
    if any(len(axis) != 3 for axis in axes) or any(pair is not None and len(pair) != 2 for pair in limits):
        raise ModelError(f"{here}: axes are lists of 3 numbers, limits lists of 2 (or empty)")
    return Joint(
        name=joint.name,
        kind=joint.kind,
        position=joint.position,
        axes=axes,  # type: ignore[arg-type]
        limits=limits,  # type: ignore[arg-type]
        limit_stiffness=joint.limit_stiffness,
        limit_damping=joint.limit_damping,
        continuous=joint.continuous,
    )


def _visual(here: str, data: Any) -> Visual:
    _check_keys(here, data, Visual)
    flat = {key: value for key, value in data.items() if key not in ("points", "triangles")}
    visual = _record(Visual, here, flat)
    if visual.shape not in get_args(VisualShape):
        raise ModelError(f"{here}: shape {visual.shape!r} is not one of {', '.join(get_args(VisualShape))}")
    points, triangles = (
        tuple(_vector(f"{here}, {key}", row) for row in _list(f"{here}, {key}", data.get(key, ())))
        for key in ("points", "triangles")
    )
    if any(corner != int(corner) for row in triangles for corner in row):
        raise ModelError(f"{here}: triangles name points by whole numbers")
    return replace(
        visual,
        points=points,  # type: ignore[arg-type]
        triangles=tuple(tuple(int(corner) for corner in row) for row in triangles),  # type: ignore[arg-type]
    )


def _plain(value: Any) -> Any:
    """Without what is None: a key is left out, an entry of a list is an empty list."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, tuple | list):
        return [[] if entry is None else _plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
