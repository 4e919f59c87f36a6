"""The spatial objective on whole frames."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from benchmarks.simulated import random_walk
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter

import planewise as pw
from planewise import scenes
from planewise.metrics import evaluate
from planewise.spatial import curvature, search
from planewise.spatial import labels as spatial_labels
from planewise.spatial.mask_code import spatial_mask_information

SENSOR = pw.Sensor(max_depth=10, noise=0.002)


def detect(depth, camera, sensor=SENSOR, **options):
    return pw.detect_planes(depth, camera, sensor, objective="spatial", **options)


def test_a_roof_has_two_planes_and_a_straight_ridge(roof, camera):
    depth, planes, labels = roof
    model = detect(depth, camera)
    assert len(model) == 2
    truth = -planes[:, :3] / planes[:, 3:]
    found = -model.coefficients[:, :3] / model.coefficients[:, 3:]
    order = [int(np.argmin(np.linalg.norm(found - row, axis=1))) for row in truth]
    assert sorted(order) == [0, 1]
    assert_allclose(found[order], truth, atol=0.01)
    assert (np.array(order)[labels - 1] + 1 == model.labels).mean() > 0.995


@pytest.mark.parametrize("name", ["staircase", "corner"])
def test_the_papers_scenes_have_four_planes(name):
    for seed in range(5):
        scene = getattr(scenes, name)(rng=seed)
        model = detect(scene.depth, scene.camera, scene.sensor)
        assert len(model) == 4
        normals = model.coefficients[:, :3]
        cosine = np.clip(scene.planes[:, :3] @ normals.T, -1, 1)
        assert np.degrees(np.arccos(cosine.max(axis=1))).max() < 0.2
        gap = np.linalg.norm(scene.planes[:, None] - model.coefficients[None], axis=2)
        match = gap.argmin(axis=1) + 1
        wrong = (match[scene.labels - 1] != model.labels) & (scene.depth > 0)
        assert wrong.mean() < 0.005


def test_the_t_junction_is_labelled_right():
    scene = scenes.t_junction(sigma=0.01)
    spatial = detect(scene.depth, scene.camera, scene.sensor)
    paper = pw.detect_planes(
        scene.depth, scene.camera, scene.sensor, search="sequential", inlier_ratio=0.25
    )

    def wrong(model):
        own = np.zeros(len(model) + 1, int)
        for j in range(1, len(model) + 1):
            own[j] = np.bincount(scene.labels[model.labels == j]).argmax()
        there = (scene.labels > 0) & (scene.depth > 0)
        return int((there & (own[model.labels] != scene.labels)).sum())

    assert wrong(paper) > 0
    assert wrong(spatial) * 10 <= wrong(paper)


def test_a_room_is_seen_as_a_person_would():
    scene = scenes.room(1)
    model = detect(scene.depth, scene.camera, pw.sensors.KINECT_V1)
    large = [n for n in range(len(scene.planes)) if (scene.labels == n + 1).sum() > 3000]
    assert scene.found(model.labels)[large].mean() > 0.8
    worth = [plane.information for plane in model.planes]
    assert worth == sorted(worth)
    assert all(plane.significance > 0 for plane in model.planes)
    assert model.information == pytest.approx(model.curve[len(model)])
    assert model.curve[len(model)] == min(model.curve)
    for k in (0, 3, len(model)):
        best = model.top(k)
        assert best.information == pytest.approx(model.curve[k])
        assert best.labels.max() == k
    mask = spatial_mask_information(model.labels, scene.depth > 0, len(model))
    assert 0 < mask < 0.02 * model.information


def test_instances_keep_surfaces_apart_that_share_a_plane(camera):
    rng = np.random.default_rng(0)
    camera = pw.PinholeCamera(fx=120, fy=120, cx=79.5, cy=59.5)
    depth = np.full((120, 160), 2.0)
    depth[:, 60:100] = 1.2
    depth += rng.normal(0, 0.002, depth.shape)
    assert len(detect(depth, camera)) == 2
    assert len(detect(depth, camera, instances=True)) == 3


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_frames_without_readings_say_why(camera, value):
    model = detect(np.full((48, 64), value), camera)
    assert len(model) == 0
    assert "0 valid readings" in model.note


@pytest.mark.parametrize("count", [1, 3, 40])
def test_a_few_scattered_readings_are_no_plane_and_no_error(camera, count):
    depth = np.zeros((48, 64))
    depth.flat[np.arange(count) * 70] = 2.0
    model = detect(depth, camera)
    assert len(model) == 0
    assert np.isfinite(model.information)


def test_rows_that_lie_far_apart_are_a_plane(camera):
    """As a LiDAR's, projected into an image."""
    depth = np.zeros((48, 64))
    depth[::4] = 2.0
    for objective in ("spatial", "paper"):
        model = pw.detect_planes(depth, camera, SENSOR, objective=objective)
        assert len(model) == 1
        assert_array_equal(model.labels, depth > 0)
        assert_allclose(model.planes[0].coefficients, [0, 0, -1, 2], atol=1e-6)


def test_a_constant_depth_is_a_plane(camera):
    model = detect(np.full((48, 64), 2.0), camera)
    assert len(model) == 1
    assert model.planes[0].count == 48 * 64
    assert_allclose(model.planes[0].normal, [0, 0, -1], atol=1e-6)


def test_uniform_noise_has_no_plane(camera):
    depth = np.random.default_rng(0).uniform(0.1, 10, (48, 64))
    model = detect(depth, camera)
    assert len(model) == 0
    assert model.note


@pytest.mark.parametrize("shape", [(2, 2), (5, 7), (48, 65), (3, 200)])
def test_any_image_size(shape):
    camera = pw.PinholeCamera(fx=100, fy=100, cx=shape[1] / 2, cy=shape[0] / 2)
    depth = 2.0 + np.random.default_rng(0).normal(0, 0.002, shape)
    sensor = pw.Sensor(max_depth=10, noise=0.002)
    observation = pw.observe(depth, camera.cropped(0, 0, shape), sensor)
    model = pw.find(observation, pw.Options(objective="spatial"))
    assert model.labels.shape == shape


def test_max_planes_and_repeatability():
    scene = scenes.room(2, size=(240, 320))
    first = detect(scene.depth, scene.camera, pw.sensors.KINECT_V1)
    second = detect(scene.depth, scene.camera, pw.sensors.KINECT_V1, threads=2)
    assert_array_equal(first.labels, second.labels)
    assert first.information == second.information
    assert len(detect(scene.depth, scene.camera, pw.sensors.KINECT_V1, max_planes=2)) == 2


def test_what_it_cannot_do_is_said(camera):
    depth = np.full((48, 64), 2.0)
    with pytest.raises(ValueError, match="needs search='joint'"):
        detect(depth, camera, search="sequential")
    for name, value in (("instances", True), ("significance", 3.0)):
        with pytest.raises(ValueError, match=f"{name} needs objective='spatial'"):
            pw.detect_planes(depth, camera, SENSOR, objective="paper", **{name: value})
        with pytest.raises(ValueError, match=f"{name} needs search='joint'"):
            pw.detect_planes(depth, camera, SENSOR, search="sequential", **{name: value})
    with pytest.raises(ValueError, match="needs a depth image, or points"):
        pw.find(pw.observe_points(np.ones((9, 3)), SENSOR), pw.Options(objective="spatial"))


def test_residuals_tell_a_bent_surface_from_a_plane():
    camera = pw.PinholeCamera(fx=200, fy=200, cx=159.5, cy=119.5)
    x = np.linspace(-1, 1, 320)
    noise = np.random.default_rng(0).normal(0, 0.004, (240, 320))
    told = []
    for bulge in (0.0, 0.003):
        model = detect(2.0 + bulge * x**2 + noise, camera, pw.Sensor(max_depth=10, noise=0.004))
        assert len(model) == 1
        told.append(model.planes[0].residual_correlation)
    assert abs(told[0]) < 0.1
    assert told[1] > 0.3


@pytest.mark.parametrize("seed", [204, 212, 213])
def test_walls_in_steps_much_coarser_than_the_noise_are_planes(seed):
    """Every terrace is flatter than the wall, but tells no more than which step that is in."""
    room = scenes.room(seed, sigma=0.0005)
    model = detect(room.depth, room.camera, room.sensor)
    for label, size in enumerate(np.bincount(room.labels.ravel())[1:], 1):
        if size > 10000:
            mine = room.labels == label
            found = model.labels == np.bincount(model.labels[mine]).argmax()
            assert model.labels[mine].any()
            assert np.sum(mine & found) > 0.95 * np.sum(mine | found)


def test_planes_can_be_cut_by_significance():
    scene = scenes.room(1, size=(240, 320))
    every = detect(scene.depth, scene.camera, scene.sensor)
    worth = sorted(plane.significance for plane in every.planes)
    few = detect(scene.depth, scene.camera, scene.sensor, significance=worth[1] + 1)
    assert 0 < len(few) < len(every)
    assert min(plane.significance for plane in few.planes) > worth[1] + 1
    with pytest.raises(ValueError, match="significance must be"):
        detect(scene.depth, scene.camera, scene.sensor, significance=-1)


def facets_of(model, room):
    """How many planes lie for the most part on what is curved."""
    flat = [(room.labels[model.labels == j + 1] > 0).mean() for j in range(len(model))]
    return sum(share < 0.5 for share in flat)


class Found(NamedTuple):
    """Mean recall and precision over rooms, facets of what is curved in them, and Phi of each."""

    recall: float
    precision: float
    facets: int
    phi: np.ndarray

    @classmethod
    def in_rooms(cls, rooms, **counted):
        models = [pw.detect_planes(room.depth, room.camera, room.sensor) for room in rooms]
        assert all(plane.significance > 0 for model in models for plane in model.planes)
        rows = [
            evaluate(model.labels, room.labels, **counted).row()
            for model, room in zip(models, rooms, strict=True)
        ]
        return cls(
            *(np.mean([row[key] for row in rows]) for key in ("recall@0.5", "precision@0.5")),
            facets=sum(map(facets_of, models, rooms)),
            phi=np.array([model.information for model in models]),
        )


def test_small_faces_of_a_room_are_planes_where_noise_is_white(monkeypatch):
    """And table legs: most of what they are too dear for where error drifts is right."""
    rooms = [scenes.room(seed, every_face=True) for seed in range(4)]
    found = Found.in_rooms(rooms)
    monkeypatch.setattr(search, "_PLANE_COST", (3.0, 3.0))
    assert found.recall > Found.in_rooms(rooms).recall + 0.05
    assert found.precision > 0.9


def test_faces_that_pay_but_for_their_border_are_planes_if_nothing_bends(monkeypatch):
    """Small ones meet others in edges that single cells do not tell from a surface that goes on."""
    rooms = [scenes.room(seed, sigma=0.0005, every_face=True) for seed in (200, 202, 206)]

    def all_sharp(cells, segments, accepted, doubtful, *rest):
        return curved_segments(cells, segments, accepted, doubtful, *rest)[0], doubtful

    found = Found.in_rooms(rooms)
    assert found.facets == 0
    with monkeypatch.context() as patch:
        patch.setattr(search, "_MOST_DRIFTING", 0.0)
        assert found.recall > Found.in_rooms(rooms).recall + 0.15
    curved_segments = search.curved_segments
    monkeypatch.setattr(search, "curved_segments", all_sharp)
    assert Found.in_rooms(rooms).facets >= 5


@pytest.mark.parametrize(("size", "gain"), [((120, 160), 0.1), ((192, 256), 0.03)])
def test_small_faces_that_end_at_breaks_are_planes_of_coarse_images(monkeypatch, size, gain):
    """Their cells are few and mixed; Phi, which is never higher with them, knows their pixels."""
    rooms = [scenes.room(seed, size=size, every_face=True) for seed in range(400, 408)]
    found = Found.in_rooms(rooms, minimum_pixels=48)
    monkeypatch.setattr(curvature, "_NEAR", -1.0)  # nothing ends at breaks
    without = Found.in_rooms(rooms, minimum_pixels=48)
    assert found.recall > without.recall + gain
    assert found.precision > 0.95
    assert found.facets <= without.facets + 2
    assert (found.phi <= without.phi).all()


@pytest.mark.parametrize(("seed", "sigma"), [(202, 0.001), (202, 0.003), (204, 0.003)])
def test_precise_readings_of_a_cylinder_are_no_fan_of_planes(monkeypatch, seed, sigma):
    """Each of its facets is flat enough; that the surface goes on at their borders tells.

    By what a border costs there, by what goes on bending, and by the readings of strips.
    """
    room = scenes.room(seed, sigma=sigma, every_face=True)

    def found():
        model = pw.detect_planes(room.depth, room.camera, room.sensor)
        return facets_of(model, room), evaluate(model.labels, room.labels).row()

    def nothing_curved(cells, segments, *_):
        return np.zeros((2, len(segments.rows)), np.bool_)

    facets, row = found()
    monkeypatch.setattr(search, "curved_segments", nothing_curved)
    assert found()[0] <= 1
    monkeypatch.setattr(
        spatial_labels, "are_folds", lambda frame, white, rows, *_: np.zeros(len(rows), bool)
    )
    assert found()[0] <= 1
    _, drifting = search._PLANE_BORDER
    monkeypatch.setattr(search, "_PLANE_BORDER", ((0.0, 1.25, 20.0), drifting))
    more_facets, row_of_more = found()
    assert facets <= 1
    assert more_facets >= 3
    assert row["precision@0.5"] > 0.95
    assert row["recall@0.5"] == row_of_more["recall@0.5"]


@pytest.mark.parametrize("seed", range(3))
def test_a_board_with_blurred_edges_is_no_part_of_the_wall_behind(monkeypatch, seed):
    """15 cm before it, at 3 m. Around it the surface goes on, as where holes were painted in."""
    shape, board = (480, 640), (slice(150, 240), slice(200, 290))
    w = np.full(shape, 1 / 3.0)
    w[board] = 1 / 2.85
    w = gaussian_filter(w, 8.0)
    noise = np.random.default_rng(seed).standard_normal(shape)
    depth = 1 / w + 0.7 * pw.sensors.KINECT_V1.sigma(1 / w) * noise
    depth = 1000 / (1 / depth + random_walk(shape, 0.004, seed))
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)

    def planes():
        model = detect(np.round(depth).astype(np.uint16), camera, pw.sensors.KINECT_V1)
        inner = model.labels[160:230, 210:280]
        return len(model), np.bincount(model.labels.ravel()).argmax(), inner

    count, wall, inner = planes()
    assert count == 2
    assert np.mean((inner != wall) & (inner > 0)) > 0.6
    monkeypatch.setattr(search, "_FEWEST_OFF", 10**9)
    count, wall, inner = planes()
    assert count == 1
    assert np.mean(inner == wall) > 0.9


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_a_row_of_pixels_tells_no_plane(seed, upright):
    """Cells at the end of the image that hold one row or column alone have none."""
    depth = np.random.default_rng(seed).normal(2, 0.004, (7, 64))
    centre = 32.0, 3.5
    if upright:
        depth, centre = depth.T, centre[::-1]
    camera = pw.PinholeCamera(fx=57.6, fy=57.6, cx=centre[0], cy=centre[1])
    model = detect(depth, camera)
    assert len(model) == 1
    assert np.isfinite(model.information)


@pytest.mark.parametrize("seed", range(4))
def test_cells_across_an_edge_are_no_strip_of_their_own(seed):
    """A column of them is a plane, but most of its pixels are those of the walls beside it."""
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    u = camera.rays((480, 640))[..., 0]
    depth = 2.5 / (1 - math.tan(math.radians(30)) * abs(u - (261.24 - 319.5) / 525))
    depth += np.random.default_rng(seed).normal(0, 0.0015, depth.shape)
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=0.0015))
    assert len(model) == 2
    assert np.mean(model.labels > 0) > 0.999


@pytest.mark.parametrize("missing", [0.1, 0.4])
def test_a_plane_that_is_full_of_holes_is_one(missing):
    """Hardly any of its cells has all its readings, while those of the wall behind have."""
    rng = np.random.default_rng(0)
    camera = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
    depth = np.full((480, 640), 3.0)
    board = np.s_[150:330, 200:420]
    depth[board] = 2.0 + 0.3 * camera.rays((480, 640))[board][..., 0]
    depth += rng.normal(0, 0.003, depth.shape)
    depth[board][rng.random((180, 220)) < missing] = 0
    model = pw.detect_planes(depth, camera, pw.Sensor(noise=0.003))
    assert len(model) == 2
    assert np.mean(model.labels[board][depth[board] > 0] == 2) > 0.99
