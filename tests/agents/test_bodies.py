"""The bodies that ship, and loading bodies by name and from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from echelon.agents import bodies
from echelon.agents.bodies import body_names, load_body
from echelon.agents.sdfast import describe_sdfast, parse_sdfast
from echelon.errors import InputError
from echelon.warp_kernels.model import Model
from echelon.warp_kernels.reference import Body

DATA = Path(__file__).parent / "data"
HUMANS = ("male", "female")
TOML = Path(bodies.__file__).parent / "bodies"

# Where the thesis puts each segment's centre of mass in the reference pose, over the floor [m]. It follows from the
# joint positions, which are other figures, to the last digit.
CENTERS_OF_MASS = {
    "male": {
        "PELVIS": (-0.006808, 0.000377, 1.001726),
        "CHEST3": (0.015173, -0.000165, 1.128768),
        "ULEGR": (-0.00807, -0.095635, 0.763461),
        "ULEGL": (-0.008117, 0.095659, 0.763682),
        "LLEGR": (-0.041461, -0.095533, 0.333228),
        "LLEGL": (-0.041456, 0.095573, 0.333268),
        "FOOTR": (-0.020427, -0.097594, 0.039208),
        "FOOTL": (-0.020427, 0.097646, 0.039199),
        "TOER": (0.084839, -0.102868, 0.018455),
        "TOEL": (0.084836, 0.102927, 0.018452),
        "CHEST2": (0.010476, 9.7e-05, 1.245442),
        "CHEST1": (-0.000434, 6.6e-05, 1.353378),
        "STERNUM": (-0.011293, -0.0002, 1.468901),
        "CHESTR": (-0.009119, -0.10425, 1.464177),
        "CHESTL": (-0.009121, 0.104279, 1.464204),
        "UARMR": (0.005265, -0.295709, 1.466786),
        "UARML": (0.00525, 0.295693, 1.466802),
        "LARMR": (0.05735, -0.590853, 1.478376),
        "LARML": (0.057842, 0.592476, 1.478385),
        "HANDR": (0.14388, -0.83178, 1.457334),
        "HANDL": (0.143888, 0.83175, 1.457274),
        "HEAD": (0.04473, -3.3e-05, 1.69329),
    },
    "female": {
        "PELVIS": (-0.027413, 0.000268, 0.887866),
        "CHEST3": (-0.010423, 0.000105, 0.99141),
        "ULEGR": (-0.026838, -0.081858, 0.66229),
        "ULEGL": (-0.026832, 0.081929, 0.6617),
        "LLEGR": (-0.038985, -0.087549, 0.262613),
        "LLEGL": (-0.038993, 0.087538, 0.262614),
        "FOOTR": (-0.014792, -0.093798, 0.036262),
        "FOOTL": (-0.014794, 0.0938, 0.036262),
        "TOER": (0.072825, -0.086748, 0.013514),
        "TOEL": (0.072825, 0.086755, 0.013509),
        "CHEST2": (-0.013545, 0.000112, 1.071086),
        "CHEST1": (-0.022843, 0.000342, 1.158771),
        "STERNUM": (-0.04648, -3e-05, 1.27014),
        "CHESTR": (-0.046724, -0.086117, 1.264862),
        "CHESTL": (-0.046841, 0.086225, 1.265165),
        "UARMR": (-0.051562, -0.295727, 1.265251),
        "UARML": (-0.051905, 0.294703, 1.264776),
        "LARMR": (-0.005165, -0.538935, 1.235356),
        "LARML": (-0.003714, 0.541634, 1.234393),
        "HANDR": (0.054932, -0.717865, 1.193023),
        "HANDL": (0.055743, 0.71993, 1.192218),
        "HEAD": (-0.046347, 2.6e-05, 1.486782),
    },
}


# ---- the two humans --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "mass"), [("male", 97.8404), ("female", 53.3042)])
def test_the_humans_have_the_published_size(name: str, mass: float):
    body = load_body(name)
    assert isinstance(body, Body)
    assert body.name == name
    assert len(body.link_names) == 22
    assert len(body.coordinate_names) == body.q_count == 56
    assert len(body.speed_names) == body.u_count == 53
    assert body.mass == pytest.approx(mass, abs=5e-5)
    assert body.gravity == 9.80665


@pytest.mark.parametrize("name", HUMANS)
def test_the_chain_of_joints_leads_to_the_published_centers_of_mass(name: str):
    body = load_body(name)
    poses = body.link_poses(body.q_reference)
    assert body.link_names == tuple(CENTERS_OF_MASS[name])
    for link, pose in zip(body.links, poses, strict=True):
        np.testing.assert_array_equal(pose[3:], (0.0, 0.0, 0.0, 1.0))
        np.testing.assert_allclose(pose[:3] + link.com, CENTERS_OF_MASS[name][link.name], rtol=0, atol=1.01e-6)


@pytest.mark.parametrize("name", HUMANS)
def test_the_soles_stand_on_the_floor(name: str):
    body = load_body(name)
    poses = body.link_poses(body.q_reference)
    points = [poses[body.link_index(site.link), :3] + site.position for site in body.contacts]
    assert len(points) == 12
    np.testing.assert_allclose(np.array(points)[:, 2], 0.0, rtol=0, atol=1e-6)
    # The centre of mass is above the soles, and the soles carry the weight with about a millimetre of sag.
    center = body.center_of_mass(body.q_reference)
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    assert np.all(low[:2] < center[:2])
    assert np.all(center[:2] < high[:2])
    sag = body.mass * body.gravity / sum(site.stiffness for site in body.contacts)
    assert 0.0008 < sag < 0.002


@pytest.mark.parametrize("name", HUMANS)
def test_left_and_right_feet_mirror_each_other(name: str):
    body = load_body(name)
    poses = body.link_poses(body.q_reference)
    points = {site.name: poses[body.link_index(site.link), :3] + site.position for site in body.contacts}
    for site, point in points.items():
        if site.endswith("_R"):
            other = points[site.removesuffix("R") + "L"]
            np.testing.assert_allclose(point, other * (1, -1, 1), rtol=0, atol=5e-4)


@pytest.mark.parametrize("name", HUMANS)
def test_every_link_is_drawn_about_where_its_mass_is(name: str):
    body = load_body(name)
    for link in body.links:
        assert link.visuals
        nearest = min(np.linalg.norm(np.subtract(visual.position, link.com)) for visual in link.visuals)
        assert nearest < 0.06, f"{link.name}: nearest shape is {nearest:.3f} m from the centre of mass"


@pytest.mark.parametrize("name", HUMANS)
def test_the_humans_as_sdfast_descriptions_are_the_same_bodies(name: str):
    one, other = load_body(DATA / f"{name}.sd"), load_body(name)
    assert isinstance(one, Body)
    assert one.coordinate_names == other.coordinate_names
    assert one.parents == other.parents
    assert one.gravity == other.gravity
    for a, b in zip(one.links, other.links, strict=True):
        assert (a.name, a.mass, a.inertia, a.com) == (b.name, b.mass, b.inertia, b.com)
        assert (a.joint.name, a.joint.kind, a.joint.axes) == (b.joint.name, b.joint.kind, b.joint.axes)
        np.testing.assert_allclose(a.joint.position, b.joint.position, rtol=0, atol=1e-15)
    assert describe_sdfast(other) == (DATA / f"{name}.sd").read_text()


# ---- loading ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", body_names())
def test_every_shipped_body_loads_and_survives_plain_data(name: str):
    body = load_body(name)
    assert body.name == name
    assert Body.from_dict(body.to_dict()) == body


def test_the_names_are_hopper_and_humans():
    assert {"hopper", *HUMANS} <= set(body_names())
    assert list(body_names()) == sorted(body_names())


def test_paths_to_both_kinds_of_file(tmp_path: Path):
    toml = tmp_path / "mine.toml"
    toml.write_bytes((TOML / "male.toml").read_bytes())
    assert load_body(toml) == load_body(str(toml)) == load_body("male")
    sdfast = tmp_path / "other.SD"
    sdfast.write_text("body = a mass = 2 inertia = 1 1 1")
    assert load_body(sdfast).mass == 2.0
    assert load_body(sdfast).name == "other"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mael", "body 'mael': did you mean 'male'?"),
        ("zebra", "or the path of a .toml or .sd file"),
        ("", "body '': allowed are"),
        ("male.txt", "allowed are"),
        ("two\nlines", "'two\\nlines'"),
        ("absent.toml", "absent.toml: cannot be read: No such file"),
        ("absent.sd", "absent.sd: cannot be read: No such file"),
        ("nul\0byte.toml", "cannot be read"),
    ],
)
def test_what_cannot_be_found_is_one_line(name: str, message: str):
    with pytest.raises(InputError) as caught:
        load_body(name)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


LINK = "[[links]]\nname = 'a'\njoint = { name = 'j', kind = 'free' }\nmass = 1.0\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("name = ", "is not TOML"),
        ("name = 'x'", "needs at least one link"),
        (LINK + "mas = 2.0", "unknown key 'mas'"),
        (LINK.replace("mass = 1.0", ""), "mass is missing"),
        (LINK.replace("1.0", "nan"), "mass: nan is not a finite number"),
        (LINK.replace("1.0", "'heavy'"), "mass: 'heavy' is not a finite number"),
        (LINK.replace("free", "hinge"), "joint kind 'hinge' is not one of"),
        (LINK + LINK.replace("'a'", "'b'\nparent = 'nobody'").replace("'j'", "'k'"), "parent 'nobody' is missing"),
        ("a = " + "[" * 5000, "is not TOML"),
        (b"name = '\xff'", "is not UTF-8"),
    ],
)
def test_a_broken_toml_body_names_file_and_fault(content: str | bytes, message: str, tmp_path: Path):
    path = tmp_path / "broken.toml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError) as caught:
        load_body(path)
    assert "broken.toml" in str(caught.value)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@given(
    edits=st.lists(
        st.tuples(
            st.floats(0.0, 1.0),
            st.sampled_from(
                ["", "nan", "-1.0", "1e999", "''", "[]", "{}", "=", "\n", "name", "true", "inf", "[[links]]"]
            ),
            st.integers(0, 12),
        ),
        min_size=1,
        max_size=3,
    )
)
@settings(max_examples=150, deadline=None)
def test_a_mutated_toml_body_gives_a_body_or_one_line(edits: list[tuple[float, str, int]], tmp_path_factory):
    text = (TOML / "male.toml").read_text().split("[[links]]")
    text = "[[links]]".join(text[:4])
    for where, put, length in edits:
        at = int(where * len(text))
        text = text[:at] + put + text[at + length :]
    path = tmp_path_factory.getbasetemp() / "mutated.toml"
    path.write_text(text)
    result = body_or_message(path)
    if isinstance(result, str):
        assert "mutated.toml" in result
        assert len(result.splitlines()) == 1
    else:
        assert result.links


def body_or_message(path: Path) -> Model | str:
    try:
        return load_body(path)
    except InputError as error:
        return str(error)


def test_a_description_knows_only_what_sdfast_knows():
    described = parse_sdfast(describe_sdfast(load_body("male")))
    assert described.contacts == ()
    assert all(link.visuals == () for link in described.links)
