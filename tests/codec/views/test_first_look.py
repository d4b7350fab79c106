from dataclasses import replace

import numpy as np
import pytest
from coverage_scenes import coverage_scene
from scipy.spatial.transform import Rotation

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import empty
from cogsplat.codec.views.first_look_search import find_first_look
from cogsplat.codec.views.framed_views import framed
from cogsplat.codec.views.up_direction import up_from_cameras
from cogsplat.codec.views.view_text import level_rotation, parse_view
from cogsplat.tools.lab.synthetic.lighting import Occluders
from cogsplat.tools.lab.synthetic.object_models import teapot, tree
from cogsplat.tools.lab.synthetic.rooms import rooms_cameras, synth_rooms
from cogsplat.tools.lab.synthetic.terrace import splats_from_surfels, synth, synth_cameras

UP = np.array([0.0, -1.0, 0.0])
FRAMES = [(1920, 1080), (390, 844)]


def turned(splats, rotation):
    """Return a scene turned about the zero of its means."""
    quats = Rotation.from_quat(splats.quats.astype(np.float64), scalar_first=True)
    return replace(
        splats,
        means=(splats.means @ rotation.T).astype(np.float32),
        quats=(Rotation.from_matrix(rotation) * quats)
        .as_quat(scalar_first=True)
        .astype(np.float32),
    )


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))


def patch(rng, count, corner, u, v):
    """Return splats that cover a parallelogram, their normals off by a few degrees."""
    u, v = np.array(u, float), np.array(v, float)
    normal = np.cross(u, v)
    frame = np.stack([u / np.linalg.norm(u), np.cross(normal, u), normal])
    frame[1:] /= np.linalg.norm(frame[1:], axis=1)[:, None]
    tilt = Rotation.from_rotvec(rng.normal(0, 0.06, (count, 3)))
    size = 0.7 * np.sqrt(np.linalg.norm(normal) / count)
    splats = empty(0, count)
    splats.means[:] = corner + rng.random((count, 1)) * u + rng.random((count, 1)) * v
    splats.quats[:] = (tilt * Rotation.from_matrix(frame.T)).as_quat(scalar_first=True)
    splats.scales[:] = np.log([size, size, 0.1 * size])
    splats.opacities[:] = 3.0
    splats.sh0[:] = rng.normal(0, 0.5, (count, 3))
    return splats


def joined(parts):
    names = ("means", "quats", "scales", "opacities", "sh0", "shN")
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **arrays)


def box(rng, count, low, high):
    low, size = np.array(low, float), np.array(high, float) - low
    edges = np.diag(size)
    return joined(
        [
            patch(rng, count // 6, low + side * edges[axis], edges[axis - 2], edges[axis - 1])
            for axis in range(3)
            for side in (0, 1)
        ]
    )


def yard():
    rng = np.random.default_rng(3)
    ground = patch(rng, 3000, [-6, 0, -6], [12, 0, 0], [0, 0, 12])
    return joined(
        [ground, box(rng, 900, [-1, -2, -1], [1, 0, 1]), box(rng, 900, [2, -1, 2], [4, 0, 3])]
    )


def train():
    rng = np.random.default_rng(4)
    return box(rng, 4000, [-8, -1.2, -0.5], [8, 0, 0.5])


def tower():
    rng = np.random.default_rng(5)
    return joined(
        [box(rng, 2400, [-1, -12, -1], [1, -1, 1]), box(rng, 1200, [-2, -1, -2], [2, 0, 2])]
    )


SCENES = {
    "yard": yard,
    "terrace": lambda: synth(8000, sh_degree=0),
    "rooms": lambda: synth_rooms(2, 12_000, sh_degree=0),
    "house": lambda: synth_rooms(6, 16_000, sh_degree=0),
    "room": lambda: coverage_scene("room", 8000).splats,
}


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    return SCENES[request.param]()


@pytest.mark.parametrize("seed", [None, 0, 1, 2])
def test_up_of_scenes_with_level_surfaces_is_found_however_they_are_turned(scene, seed):
    rotation = np.eye(3) if seed is None else Rotation.random(random_state=seed).as_matrix()
    look = find_first_look(turned(scene, rotation))
    assert look.up is not None
    assert np.linalg.norm(look.up) == pytest.approx(1, abs=1e-4)
    assert degrees(look.up, rotation @ UP) < 5


def up_of(splats):
    """Return the up direction of a scene; the first view is given, so that none is searched for."""
    up = find_first_look(splats, view="0,0,-9,0,0,0,40").up
    assert up is not None
    return up


@pytest.mark.parametrize("name", ["yard", "terrace", "rooms", "house"])
def test_scenes_whose_axes_are_a_quarter_turn_off_come_upright(name):
    rotation = Rotation.from_rotvec([0.5 * np.pi, 0, 0]).as_matrix()
    assert degrees(up_of(turned(SCENES[name](), rotation)), rotation @ UP) < 5


def made_object(name):
    """Return an object without a ground."""
    if name in ("teapot", "tree"):
        rng = np.random.default_rng(3)
        surfels = {"teapot": teapot, "tree": tree}[name](6000, rng)
        return splats_from_surfels(surfels, Occluders(np.zeros((0, 5)), np.zeros((0, 7))), rng, 0)
    made = {"train": train, "tower": tower}.get(name)
    return coverage_scene(name, 6000).splats if made is None else made()


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", ["lamp", "teapot", "tower", "tree"])
def test_objects_without_a_ground_come_upright_however_they_are_turned(name, seed):
    rotation = Rotation.random(random_state=seed).as_matrix()
    assert degrees(up_of(turned(made_object(name), rotation)), rotation @ UP) < 5


OBJECTS = ["lamp", "fence", "shell", "card", "statue", "teapot", "train", "tower", "tree"]


@pytest.mark.parametrize("name", OBJECTS)
def test_upright_objects_keep_the_up_of_the_format(name):
    splats = made_object(name)
    for axes, up in (("RDF", [0, -1, 0]), ("RUB", [0, 1, 0]), ("RFU", [0, 0, 1])):
        rotation = Rotation.align_vectors([up], [UP])[0].as_matrix()
        made = turned(splats, rotation)
        found = up_of(replace(made, info=replace(made.info, axes=axes)))
        assert degrees(found, np.array(up, float)) < 1


def wobbly(cameras, roll_degrees, rng):
    """Return cameras that are held level to within some degrees."""
    found = []
    for camera in cameras:
        angle = np.radians(rng.normal(0, roll_degrees))
        roll = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        found.append(
            replace(camera, rotation=roll @ camera.rotation, translation=roll @ camera.translation)
        )
    return found


@pytest.mark.parametrize("cameras", [synth_cameras(24), rooms_cameras(2)], ids=["around", "inside"])
def test_up_of_cameras_is_orthogonal_to_their_right_axes(cameras):
    rng = np.random.default_rng(1)
    rotation = Rotation.random(random_state=4).as_matrix()
    moved = [replace(c, rotation=c.rotation @ rotation.T) for c in wobbly(cameras, 2, rng)]
    # A few were held upright.
    moved[:2] = wobbly(moved[:2], 90, rng)
    assert degrees(up_from_cameras(moved, UP), rotation @ UP) < 2


def test_cameras_in_a_row_have_the_up_that_they_share():
    one = synth_cameras(4, 64, 48)[1]
    row = [replace(one, translation=one.translation + np.array([x, 0, 0])) for x in range(5)]
    assert degrees(up_from_cameras(row, UP), -one.rotation[1]) < 0.1


def test_cameras_that_contradict_each_other_leave_up_to_the_format():
    cameras = [
        replace(synth_cameras(1, 64, 48)[0], rotation=Rotation.random(random_state=k).as_matrix())
        for k in range(60)
    ]
    assert degrees(up_from_cameras(cameras, UP), UP) < 1e-6


def assert_inside(camera, points, frames=FRAMES):
    """Assert that points lie in a view, fitted into each frame as a viewer does."""
    seen = points @ camera.rotation.T + camera.translation
    assert (seen[:, 2] > 0.2).all()
    for width, height in frames:
        scale = min(width / camera.width, height / camera.height)
        shown = np.abs(seen[:, :2] / seen[:, 2:]) * [camera.fx * scale, camera.fy * scale]
        assert (shown < [0.5 * width, 0.5 * height]).all()
        # Nor is it far away.
    whole = np.abs(seen[:, :2] / seen[:, 2:]) * [camera.fx, camera.fy]
    assert (whole.max(axis=0) / [0.5 * camera.width, 0.5 * camera.height]).max() > 0.8


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("name", ["lamp", "fence", "statue", "train", "tower"])
def test_a_whole_object_is_in_a_wide_and_in_an_upright_frame(name, scale):
    splats = {"train": train, "tower": tower}.get(name, lambda: coverage_scene(name, 6000).splats)()
    splats = replace(
        splats,
        means=splats.means * np.float32(scale),
        scales=splats.scales + np.float32(np.log(scale)),
    )
    for seed in (None, 7):
        rotation = np.eye(3) if seed is None else Rotation.random(random_state=seed).as_matrix()
        made = turned(splats, rotation)
        look = find_first_look(made)
        assert look.view is not None
        assert look.up is not None
        means = made.means.astype(np.float64)
        low, high = np.quantile(means, (0.005, 0.995), axis=0)
        assert_inside(look.view, means[((means >= low) & (means <= high)).all(axis=1)])
        assert abs(look.view.rotation[0] @ look.up) < 1e-6, "the horizon is level"


def test_rooms_are_seen_from_inside():
    splats = synth_rooms(2, 12_000, sh_degree=0)
    view = find_first_look(splats).view
    assert view is not None
    low, high = splats.means.min(axis=0), splats.means.max(axis=0)
    assert ((view.position > low) & (view.position < high)).all()
    assert view.target is not None
    assert np.linalg.norm(view.target - view.position) > 1


def test_the_first_view_of_a_capture_is_one_of_its_cameras_without_roll():
    splats, cameras = synth(8000, sh_degree=0), synth_cameras(24)
    look = find_first_look(splats, wobbly(cameras, 3, np.random.default_rng(2)))
    assert look.view is not None
    assert look.up is not None
    assert min(np.linalg.norm(look.view.position - c.position) for c in cameras) < 1e-6
    assert abs(look.view.rotation[0] @ look.up) < 1e-6
    # What the capture goes around is the target: the objects in the middle of the terrace.
    assert look.view.target is not None
    assert np.linalg.norm(look.view.target * [1, 0, 1]) < 2.5


def test_floaters_and_sky_lie_outside_the_core_box():
    splats = yard()
    stray = splats.take(slice(0, 30))
    stray.means[:] = np.random.default_rng(1).normal(0, 400, (30, 3))
    sky = patch(np.random.default_rng(2), 40, [-500, -300, -500], [1000, 0, 0], [0, 0, 1000])
    look = find_first_look(joined([splats, stray, sky]))
    plain = find_first_look(splats)
    for found in (look, plain):
        assert found.core_box is not None
        np.testing.assert_allclose(found.core_box, [-6, -2, -6, 6, 0, 6], atol=0.4)


def test_up_and_view_that_are_given_are_kept():
    splats = train()
    look = find_first_look(splats, up="0,3,4", view="0,-3,-20,0,0,0,40")
    assert look.up is not None
    np.testing.assert_allclose(look.up, [0, 0.6, 0.8])
    assert look.view is not None
    np.testing.assert_allclose(look.view.position, [0, -3, -20], atol=1e-9)
    camera = parse_view("0,-3,-20,0,0,0,40").camera(UP)
    aimed = find_first_look(splats, view=replace(camera, target=None)).view
    assert aimed is not None
    assert aimed.target is not None
    np.testing.assert_allclose(aimed.rotation, camera.rotation)
    # The side of the train that faces the camera.
    assert aimed.target[2] == pytest.approx(-0.5, abs=0.5)


@pytest.mark.parametrize("make", [yard, lambda: synth_rooms(2, 12_000, sh_degree=0)])
def test_a_look_is_the_same_for_any_number_of_threads_and_without_sh(make):
    splats = make()
    one, other = find_first_look(splats, threads=1), find_first_look(splats, threads=3)
    for name in ("up", "core_box"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert one.view is not None
    assert other.view is not None
    for name in ("rotation", "translation", "target", "fx"):
        assert np.array_equal(getattr(one.view, name), getattr(other.view, name))


def test_scenes_of_nothing_have_the_up_of_the_format_alone():
    for splats in (empty(0, 0), replace(empty(0, 9), opacities=np.full(9, -30, np.float32))):
        look = find_first_look(splats)
        assert (look.view, look.core_box) == (None, None)
        assert look.up is not None
        assert look.up.tolist() == [0, -1, 0]


def test_one_splat_is_looked_at():
    look = find_first_look(replace(empty(0, 1), opacities=np.full(1, 3, np.float32)))
    assert isinstance(look.view, Camera)


def test_a_framed_view_holds_points_tightly():
    rng = np.random.default_rng(0)
    for spread in ([9, 1, 1], [1, 9, 1], [1, 1, 9], [1, 1, 1]):
        points = rng.normal(0, 1, (200, 3)) * spread + [3, 4, 5]
        towards = rng.normal(0, 1, 3)
        towards /= np.linalg.norm(towards)
        camera = framed(points, points.mean(axis=0), towards, UP, 0.4)
        assert_inside(camera, points, [*FRAMES, (camera.width, camera.height)])
        np.testing.assert_allclose(camera.rotation, level_rotation(towards, UP))
