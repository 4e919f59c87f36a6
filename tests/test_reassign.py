"""Reassignment by surface normals, against plain loops, the planes of scenes, and the judge."""

import dataclasses
import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import planewise as pw
from planewise import scenes
from planewise.options import Options
from planewise.paper.reassign import surface_normals
from planewise.search import find
from tests.command import run

from .conftest import render

SIZE = (240, 320)
HOW = pw.NormalReassignment()
SEARCHES = pytest.mark.parametrize("search", ["sequential", "joint"])


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


def normals_one_by_one(points, seen, how):
    """Tangents by `polyfit` over what is seen along row and column, a Gaussian sum a pixel."""
    height, width = seen.shape
    half, reach = how.gradient // 2, math.ceil(3 * how.smoothing)
    raw = np.zeros(points.shape)

    def tangent(line, there, at):
        near = [i for i in range(max(0, at - half), min(len(there), at + half + 1)) if there[i]]
        return np.polyfit(near, line[near], 1)[0] if len(near) > 1 else np.full(3, np.nan)

    for y, x in np.argwhere(seen):
        along_x = tangent(points[y], seen[y], x)
        along_y = tangent(points[:, x], seen[:, x], y)
        normal = np.cross(along_y, along_x)
        size = np.linalg.norm(normal)
        if size > 0:
            raw[y, x] = normal / size * (-1 if normal @ points[y, x] > 0 else 1)
    out = np.full(points.shape, np.nan)
    for y, x in np.argwhere(seen):
        rows = np.arange(max(0, y - reach), min(height, y + reach + 1))
        columns = np.arange(max(0, x - reach), min(width, x + reach + 1))
        square = (rows[:, None] - y) ** 2 + (columns - x) ** 2
        weight = np.exp(-0.5 * square / how.smoothing**2) if how.smoothing else np.ones((1, 1))
        total = np.einsum("yx,yxc->c", weight, raw[np.ix_(rows, columns)])
        if (size := np.linalg.norm(total)) > 0:
            out[y, x] = total / size
    return out


def holes(rng, shape):
    """Where something is seen: a block, a column and single pixels are missing."""
    seen = rng.random(shape) > 0.1
    seen[10:20, 12:30] = False
    seen[:, 40] = False
    seen[14, 20] = True  # alone in the hole
    return seen


@pytest.mark.parametrize("how", [HOW, pw.NormalReassignment(gradient=3, smoothing=0)])
def test_on_a_tilted_plane_the_normals_are_the_planes(camera, how):
    plane = np.array([0.5, -0.3, -math.sqrt(1 - 0.34), 1.4])
    depth, _ = render(plane[None], camera, (48, 64))
    seen = holes(np.random.default_rng(0), depth.shape)
    points = camera.rays(depth.shape) * np.where(seen, depth, np.nan)[..., None]
    normals = surface_normals(points, seen, how)
    known = ~np.isnan(normals[..., 0])
    assert not known[~seen].any()
    assert known[seen].mean() > 0.95
    assert known[14, 20] == (how.smoothing > 0)  # its neighbours' normals reach over the hole
    assert_allclose(normals[known], np.broadcast_to(plane[:3], normals[known].shape), atol=1e-9)


def test_normals_of_a_rough_surface_with_holes_are_those_of_plain_loops(camera):
    rng = np.random.default_rng(1)
    depth = 1.5 + 0.2 * np.sin(np.arange(48) / 7)[:, None] + rng.normal(0, 0.01, (48, 64))
    seen = holes(rng, depth.shape)
    points = camera.rays(depth.shape) * depth[..., None]
    for how in (
        pw.NormalReassignment(gradient=5, smoothing=1.2),
        pw.NormalReassignment(gradient=3, smoothing=0.0),
    ):
        expected = normals_one_by_one(points, seen, how)
        assert_allclose(surface_normals(points, seen, how), expected, atol=1e-9)


def test_the_noise_of_a_normal_is_the_one_that_is_assumed():
    camera = pw.PinholeCamera(fx=500, fy=500, cx=100, cy=100)
    shape, z, sigma = (200, 200), 2.0, 0.001
    depth = z + np.random.default_rng(2).normal(0, sigma, shape)
    points = camera.rays(shape) * depth[..., None]
    for how in (HOW, pw.NormalReassignment(gradient=9, smoothing=1.0)):
        normals = surface_normals(points, np.ones(shape, bool), how)[20:-20, 20:-20]
        assumed = how.slope_noise * sigma / (z / 500)
        assert normals[..., :2].std() == pytest.approx(assumed, rel=0.15)


def misassigned(scene, model):
    """Readings given to another plane than theirs; those given to none do not count."""
    nearest = [np.abs(scene.planes - row).sum(axis=1).argmin() for row in model.coefficients]
    labels = np.concatenate(([0], np.array(nearest) + 1))[model.labels]
    return int(((labels != scene.labels) & (labels > 0)).sum())


def t_junction(sigma):
    """The scene in which the paper's search finds the plane further away first."""
    scene = scenes.t_junction(edge=0.0, sigma=sigma, quantise=False, size=SIZE)
    return scene, dataclasses.replace(scene.sensor, noise=pw.noise.constant(0.005))


def both(scene, sensor, search, reassign="normals"):
    options = {"search": search, "objective": "paper"}
    before = pw.detect_planes(scene.depth, scene.camera, sensor, **options)
    after = pw.detect_planes(scene.depth, scene.camera, sensor, **options, reassign=reassign)
    return before, after


@SEARCHES
def test_without_noise_a_t_junction_comes_out_right(search):
    scene, sensor = t_junction(0.0)
    before, after = both(scene, sensor, search)
    assert misassigned(scene, before) > (2000 if search == "sequential" else 0)
    assert misassigned(scene, after) == 0
    assert (after.labels > 0).all()


@SEARCHES
def test_with_noise_few_of_the_misassigned_are_left(search):
    scene, sensor = t_junction(0.005)
    before, after = both(scene, sensor, search)
    assert misassigned(scene, before) > 500
    assert misassigned(scene, after) < misassigned(scene, before) / 10


@SEARCHES
def test_a_small_kernel_does_not_bear_noise(search):
    scene, sensor = t_junction(0.005)
    small = pw.NormalReassignment(gradient=3, smoothing=0.0)
    assert misassigned(scene, both(scene, sensor, search, small)[1]) > 500


@SEARCHES
def test_phi_of_what_comes_out_is_exact_and_the_planes_are_ranked(search):
    scene = scenes.corner(size=SIZE)
    before, after = both(scene, scene.sensor, search)
    observation = pw.observe(scene.depth, scene.camera, scene.sensor)
    judged = pw.information(observation, after.planes, after.labels)
    assert after.information == pytest.approx(judged, rel=1e-12)
    assert after.information != before.information
    # No search of planes and labels together is below a labelling that looks at something else.
    assert (after.information > before.information) == (search == "joint")
    worth = [plane.information for plane in after.planes]
    assert worth == sorted(worth)
    assert max(worth) < 0
    assert [plane.count for plane in after.planes] == np.bincount(after.labels.flat)[1:].tolist()
    for k in range(len(after) + 1):
        smaller = after.top(k)
        judged = pw.information(observation, smaller.planes, smaller.labels)
        assert smaller.information == pytest.approx(judged, rel=1e-12)
    # The planes are those of the search, only the readings move.
    rows = {tuple(row) for row in np.round(before.coefficients, 12)}
    assert {tuple(row) for row in np.round(after.coefficients, 12)} <= rows
    assert_array_equal(after.curve.information, before.curve.information)
    last = after.curve.moves[-1]
    assert (last.kind, last.planes) == ("reassign", len(after))
    assert last.information == after.information


def test_every_reading_saves_nats_where_it_goes():
    scene = scenes.room(1, size=(120, 160))
    options = {"search": "sequential", "reassign": "normals"}
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, **options)
    observation = pw.observe(scene.depth, scene.camera, scene.sensor)
    labels = model.labels.reshape(-1)[observation.index]
    threshold = np.log(observation.range / (observation.sigma * math.sqrt(2 * math.pi)))
    for j, row in enumerate(model.coefficients, start=1):
        mine = labels == j
        error = 0.5 * (observation.residuals(row) / observation.sigma)[mine] ** 2
        assert (error < threshold[mine] + 1e-9).all()


def test_readings_without_neighbours_keep_their_plane():
    rng = np.random.default_rng(4)
    depth = np.where(np.add.outer(np.arange(120), np.arange(160)) % 8 == 0, 2.0, 0.0)
    depth[depth > 0] += rng.normal(0, 0.002, (depth > 0).sum())
    camera, sensor = pw.PinholeCamera(fx=125, fy=125, cx=80, cy=60), pw.Sensor(noise=0.002)
    options = {"search": "sequential", "objective": "paper"}
    before = pw.detect_planes(depth, camera, sensor, **options)
    small = pw.NormalReassignment(gradient=3, smoothing=1.0)
    after = pw.detect_planes(depth, camera, sensor, **options, reassign=small)
    assert len(before) == 1
    assert_array_equal(after.labels, before.labels)
    assert after.information == pytest.approx(before.information, rel=1e-12)


def test_the_input_stays_and_threads_do_not_matter():
    scene, sensor = t_junction(0.005)
    depth = scene.depth.copy()
    depth.flags.writeable = False
    options = {"search": "sequential", "reassign": "normals"}
    one, two = (pw.detect_planes(depth, scene.camera, sensor, **options, threads=n) for n in (1, 2))
    assert_array_equal(one.labels, two.labels)
    assert one.information == two.information


def test_a_frame_without_planes_stays_one():
    camera = pw.PinholeCamera(fx=50, fy=50, cx=32, cy=24)
    empty = pw.detect_planes(
        np.zeros((48, 64)), camera, pw.Sensor(), search="sequential", reassign="normals"
    )
    rng = np.random.default_rng(0)
    noise = pw.detect_planes(
        rng.uniform(1, 9, (48, 64)), camera, pw.Sensor(), search="sequential", reassign="normals"
    )
    assert len(empty) == len(noise) == 0
    assert empty.note
    assert noise.note


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reassign": "normals"}, "reassign needs objective='paper'"),
        ({"reassign": "normals", "objective": "spatial"}, "reassign needs objective='paper'"),
        ({"reassign": "edges", "objective": "paper"}, "reassign must be 'normals'.*'edges'"),
        ({"reassign": True, "objective": "paper"}, "reassign must be 'normals'.*True"),
    ],
)
def test_what_cannot_be_done_is_refused(options, message, camera):
    with pytest.raises(ValueError, match=message):
        pw.detect_planes(np.ones((48, 64)), camera, pw.Sensor(), **options)


def test_free_points_cannot_be_reassigned():
    points = np.random.default_rng(0).random((100, 3))
    options = Options(search="sequential", reassign="normals")
    with pytest.raises(ValueError, match="reassign needs a depth image"):
        find(pw.observe_points(points, pw.Sensor(noise=0.01)), options)


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({"gradient": 4}, "gradient must be an odd number of pixels, at least 3, got 4"),
        ({"gradient": 1}, "gradient must be an odd"),
        ({"gradient": 3.0}, "gradient must be a whole number of pixels, got 3.0"),
        ({"smoothing": -1.0}, "smoothing must be a number of pixels, not negative, got -1.0"),
        ({"smoothing": math.nan}, "smoothing must be"),
        ({"smoothing": "a"}, "smoothing must be a number of pixels, not negative, got 'a'"),
    ],
)
def test_sizes_are_checked(sizes, message):
    with pytest.raises(ValueError, match=message):
        pw.NormalReassignment(**sizes)


def test_sizes_may_be_numbers_of_numpy():
    how = pw.NormalReassignment(gradient=np.int64(5), smoothing=np.float32(2))
    assert how == pw.NormalReassignment(gradient=5, smoothing=2.0)
    assert json.dumps(asdict(how)) == '{"gradient": 5, "smoothing": 2.0}'


def test_a_kernel_larger_than_the_image_is_no_error(roof, camera):
    how = pw.NormalReassignment(gradient=201, smoothing=60.0)
    options = {"search": "sequential", "reassign": how}
    model = pw.detect_planes(roof[0], camera, pw.Sensor(noise=0.002), **options)
    assert 1 <= len(model) <= 2


def test_the_command_line_has_it(tmp_path):
    scene = scenes.t_junction(edge=0.0, size=(120, 160))
    Image.fromarray(scene.depth).save(tmp_path / "depth.png")
    arguments = ["detect", tmp_path / "depth.png", "--camera", "125,125,80,60", "--noise", "5mm"]
    arguments += ["-o", tmp_path / "out", "--reassign", "normals"]
    code, _, errors = run(*arguments)
    assert code == 2
    assert "--reassign needs --objective paper or --search sequential" in errors
    code, _, errors = run(*arguments, "--search", "sequential")
    assert code == 0, errors
    record = json.loads((tmp_path / "out" / "planes.json").read_text())
    assert record["options"]["reassign"] == {"normals": {"gradient": 7, "smoothing": 3.0}}
    assert record["curve"]["moves"][-1]["kind"] == "reassign"
