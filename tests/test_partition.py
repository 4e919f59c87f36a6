from __future__ import annotations

import json
import re
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal

import planewise as pw
from planewise import scenes
from planewise.partition import (
    Blocks,
    Graph,
    PartitionOptions,
    SegmentAnything,
    View,
    as_partitioner,
    describe,
    regions_of,
    regions_of_labels,
    regions_of_masks,
)
from planewise.partition.graph import normals
from tests.lent import Lent

SHAPE = (48, 64)


@pytest.fixture
def view(camera):
    return View(depth=np.full(SHAPE, 2.0), camera=camera)


def test_labels_are_numbered_without_gaps():
    labels = [[0, 7, 7], [3, 3, 100]]
    assert regions_of_labels(labels, (2, 3)).tolist() == [[0, 2, 2], [1, 1, 3]]
    assert regions_of_labels([[5, 5], [9, 5]], (2, 2)).tolist() == [[1, 1], [2, 1]]
    assert regions_of_labels(np.zeros((2, 2), bool), (2, 2)).tolist() == [[0, 0], [0, 0]]


def test_a_pixel_belongs_to_the_smallest_mask_that_holds_it():
    table, book, empty = (np.zeros((4, 5), bool) for _ in range(3))
    table[1:, :4], book[2:, 1:3] = True, True
    wanted = np.where(book, 2, table)
    # In any order: numbers follow it.
    assert np.array_equal(regions_of_masks([table, book], (4, 5)), wanted)
    swapped = np.where(book, 1, np.where(table, 2, 0))
    assert np.array_equal(regions_of_masks([book, table], (4, 5)), swapped)
    # Empty masks and covered ones are no region; of equal ones the first is.
    assert np.array_equal(regions_of_masks([empty, table, empty, book, book], (4, 5)), wanted)
    assert not regions_of_masks([empty], (4, 5)).any()
    assert not regions_of_masks([], (4, 5)).any()


@given(arrays(bool, st.tuples(st.integers(1, 6), st.just(4), st.just(5))))
@settings(max_examples=60)
def test_masks_against_the_rule_pixel_by_pixel(masks):
    regions = regions_of_masks(masks, (4, 5))
    sizes = masks.sum(axis=(1, 2))
    owner = np.zeros((4, 5), int)
    for at in np.ndindex(4, 5):
        holding = [i for i in range(len(masks)) if masks[i][at]]
        owner[at] = 1 + min(holding, key=lambda i: (sizes[i], i)) if holding else 0
    # The same parts, and numbers in the order of the masks.
    pairs = {(int(a), int(b)) for a, b in zip(owner.flat, regions.flat, strict=True)}
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    assert sorted(pairs) == sorted(pairs, key=lambda pair: pair[1])
    assert set(np.unique(regions)) - {0} == set(range(1, regions.max() + 1))


@pytest.mark.parametrize(
    ("partition", "message"),
    [
        (np.zeros((48, 63), int), r"shape \(48, 64\), got a label image of shape \(48, 63\)"),
        (np.full(SHAPE, 0.5), "whole numbers as labels, got float64"),
        (np.full(SHAPE, -1), "must not hold negative labels, got -1"),
        (np.zeros((3, 48, 63), bool), r"got mask 0 of shape \(48, 63\)"),
        ([np.zeros(SHAPE, bool), np.zeros((2, 2), bool)], r"got mask 1 of shape \(2, 2\)"),
        ([np.zeros(SHAPE)], "boolean masks, got mask 0 of float64"),
        ("squares", "'auto', 'graph', 'blocks', 'sam', a label image, masks"),
        (np.zeros(5, int), r"shape \(H, W\) or masks of shape \(N, H, W\), got shape \(5,\)"),
        ([], "got an empty list"),
        (3, "got int"),
        ("sam", "partition 'sam' needs rgb"),
        (lambda view: np.zeros((2, 2), int), r"label image of shape \(2, 2\)"),
        (lambda view: None, r"partition must return a label image .*, got NoneType"),
    ],
)
def test_what_is_no_partition_is_refused(partition, message, camera):
    with pytest.raises(ValueError, match=message):
        pw.detect_planes(np.full(SHAPE, 2.0), camera, pw.Sensor(), partition=partition)


@pytest.mark.parametrize(
    "given", [Lent, memoryview, np.asarray, lambda a: np.asarray(a).tolist(), lambda a: [a == 1]]
)
def test_partitions_are_arrays_of_any_kind_and_copied(view, given):
    labels = np.zeros(SHAPE, np.uint8)
    labels[:20] = 1
    expected = labels.copy()
    partition = given(labels)
    made = as_partitioner(partition)
    if isinstance(partition, list) and isinstance(partition[0], np.ndarray):
        partition[0][:] = False
    labels[:] = 7
    assert_array_equal(regions_of(made, view), expected)
    assert_array_equal(regions_of(lambda view: Lent(expected), view), expected)


def test_what_is_masked_is_in_no_region(view):
    labels = np.ma.array(np.ones(SHAPE, int), mask=np.indices(SHAPE)[1] < 9)
    for partition in (labels, [labels], lambda view: labels, labels[None]):
        regions = regions_of(as_partitioner(partition), view)
        assert_array_equal(regions, np.where(labels.mask, 0, 1))


@pytest.mark.parametrize("name", ["points", "batch"])
@pytest.mark.parametrize("wrong", [0, 2.5, True, "a"])
def test_points_of_segment_anything_are_whole(name, wrong):
    with pytest.raises(ValueError, match=f"{name} must be a whole number of at least 1, got"):
        SegmentAnything(**{name: wrong})


def test_a_picture_of_another_shape_is_refused(camera):
    rgb = np.zeros((48, 63, 3), np.uint8)
    with pytest.raises(ValueError, match=r"rgb must be uint8 of shape \(48, 64, 3\), got uint8"):
        pw.detect_planes(np.full(SHAPE, 2.0), camera, pw.Sensor(), partition="blocks", rgb=rgb)


def test_points_have_no_regions():
    from planewise.options import Options

    points = pw.observe_points(np.random.default_rng(0).normal(size=(50, 3)), pw.Sensor(noise=0.01))
    with pytest.raises(ValueError, match="partition needs a depth image"):
        pw.find(points, Options(partition="blocks"))


@pytest.mark.parametrize(
    "options",
    [
        {"confidence": 1.0},
        {"confidence": "a"},
        {"region_inlier_ratio": 0.0},
        {"remainder_planes": 0},
        {"region_planes": True},
    ],
)
def test_options_are_checked(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        PartitionOptions(**options)


def test_options_may_be_numbers_of_numpy():
    options = PartitionOptions(region_planes=np.int64(3), remainder_inlier_ratio=np.float32(0.5))
    assert options == PartitionOptions(region_planes=3, remainder_inlier_ratio=0.5)
    assert json.loads(json.dumps(asdict(options))) == asdict(options)


def test_the_papers_values_are_the_defaults():
    options = PartitionOptions()
    assert (options.confidence, options.region_planes, options.region_inlier_ratio) == (
        0.99,
        4,
        0.2,
    )
    assert (options.remainder_planes, options.remainder_inlier_ratio) == (8, 0.1)


def test_blocks(view):
    regions = regions_of(Blocks(rows=32, columns=40), view)
    assert regions[0, 0] == regions[31, 39] == 1
    assert (regions[0, 40], regions[32, 0], regions[47, 63]) == (2, 3, 4)
    with pytest.raises(ValueError, match="rows must be a whole number of at least 2, got 1"):
        Blocks(rows=1)
    assert Blocks(rows=np.int64(20)) == Blocks(rows=20)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("scale", np.inf, "scale must be a positive number, got inf"),
        ("scale", "large", "scale must be a positive number, got 'large'"),
        ("colour", -1.0, r"colour must be a number that is not negative, got -1\.0"),
        ("least", True, "least must be a whole number of at least 1, got True"),
        ("reach", 2.5, r"reach must be a whole number of at least 1, got 2\.5"),
    ],
)
def test_settings_that_no_graph_has(name, value, message):
    with pytest.raises(ValueError, match=message):
        Graph(**{name: value})


def test_any_function_and_object_will_do(view):
    def halves(seen):
        return np.arange(seen.depth.shape[1]) // 32 * np.ones((seen.depth.shape[0], 1), int)

    assert np.unique(regions_of(as_partitioner(halves), view)).tolist() == [0, 1]
    assert describe(as_partitioner(halves)) == "halves"
    masks = as_partitioner(lambda seen: [seen.depth > 1, seen.depth > 3])
    assert (regions_of(masks, view) == 1).all()
    assert describe(as_partitioner([[0, 1], [1, 1]])) == "label image"
    rows, lists = [[0] * 64] * 20 + [[1] * 64] * 28, as_partitioner(lambda seen: rows)
    assert_array_equal(regions_of(lists, view), regions_of(as_partitioner(rows), view))
    masks = as_partitioner(lambda seen: [rows, rows])
    assert_array_equal(regions_of(masks, view), regions_of(lists, view))
    assert describe(as_partitioner(np.zeros((3, *SHAPE), bool))) == "3 masks"


@pytest.mark.parametrize("kind", [Graph, SegmentAnything, Blocks])
def test_every_setting_is_told(kind):
    usual = kind()
    told = {usual.describe()}
    for name, value in asdict(usual).items():
        changed = value + "x" if isinstance(value, str) else value * (1 - 1e-8)
        told.add(kind(**{name: value + 1 if isinstance(value, int) else changed}).describe())
    assert len(told) == 1 + len(asdict(usual))
    assert Graph().describe() == "graph, scale 1000, regions of at least 300 pixels"


def test_graph_follows_depth_and_colour(camera, roof):
    depth, _, labels = roof
    graph = Graph()
    regions = regions_of(graph, View(depth=depth, camera=camera))
    # Both sides of the roof, but for the pixels whose neighbourhood lies on both.
    assert regions.max() == 2
    assert np.count_nonzero((regions == regions[24, 0]) != (labels == labels[24, 0])) < 100
    # A wall in two colours, with a hole: two regions more or less, and colour makes them.
    wall = np.full(SHAPE, 2.0)
    wall[20:24, 30:40] = np.nan
    rgb = np.zeros((*SHAPE, 3), np.uint8)
    rgb[:, 32:] = 255
    plain = regions_of(graph, View(depth=wall, camera=camera))
    colour = regions_of(graph, View(depth=wall, camera=camera, rgb=rgb))
    assert plain[5, 5] == plain[5, 60]
    assert colour[5, 5] != colour[5, 60]


@pytest.mark.filterwarnings("ignore:divide by zero")
def test_normals_of_range_images_are_those_of_the_planes():
    camera = pw.SphericalCamera.spinning(np.linspace(15, -25, 48), columns=360)
    planes = np.array(
        [[0, 0, 1, 1.8], [-1, 0, 0, 8.0], [1, 0, 0, 9.0], [0, 1, 0, 6], [0, -1, 0, 7]]
    )
    ranges = -planes[:, 3:] / (planes[:, :3] @ camera.ray_rows(camera.shape))
    ranges[ranges <= 0] = np.inf
    on = np.argmin(ranges, axis=0).reshape(camera.shape)
    found = normals(View(depth=ranges.min(axis=0).reshape(camera.shape), camera=camera), 2)
    # Away from where planes meet; all the way round, over the ends of the image, too.
    around = np.pad(np.pad(on, ((0, 0), (2, 2)), mode="wrap"), ((2, 2), (0, 0)), mode="edge")
    window = np.lib.stride_tricks.sliding_window_view(around, (5, 5))
    inside = (window == on[..., None, None]).all(axis=(2, 3))
    assert np.unique(on[inside]).size == 5
    assert inside[:, [0, -1]].any(axis=0).all()
    assert np.allclose(found[inside], planes[on[inside], :3], atol=1e-6)


def test_graph_says_which_extra_it_needs(monkeypatch, view):
    monkeypatch.setitem(__import__("sys").modules, "skimage.segmentation", None)
    with pytest.raises(ValueError, match=r"pip install 'planewise\[partition\]'"):
        Graph()(view)


@pytest.mark.parametrize(("module", "package"), [("torch", "torch"), ("PIL", "pillow")])
def test_segment_anything_says_which_extra_it_needs(monkeypatch, camera, module, package):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    view = View(depth=np.ones(SHAPE), camera=camera, rgb=np.zeros((*SHAPE, 3), np.uint8))
    message = rf"needs the package {package}, .* pip install 'planewise\[sam\]'"
    with pytest.raises(ValueError, match=message):
        SegmentAnything(model="none of this name")(view)
    with pytest.raises(ValueError, match=r"stability must lie in 0 \.\.\. 1, got 2"):
        SegmentAnything(stability=2)
    assert SegmentAnything(model="/a/folder/").describe() == (
        "Segment Anything (folder), stability of at least 0.98"
    )


@pytest.mark.parametrize(
    "place", ["../nowhere", "/no/where", "./sam", "nowhere/", "a/b/c", "a\\b\\c"]
)
def test_a_folder_of_weights_that_is_not_there_is_said(place, camera):
    view = View(depth=np.ones(SHAPE), camera=camera, rgb=np.zeros((*SHAPE, 3), np.uint8))
    with pytest.raises(ValueError, match=f"sam: there is no folder {re.escape(place)}; give a"):
        SegmentAnything(model=place)(view)


@pytest.fixture(scope="module")
def corner():
    return scenes.corner(size=(120, 160), sigma=0.005)


def exact_phi(model, scene):
    """Phi of labels and planes by the judge (paper)."""
    seen = pw.observe(scene.depth, scene.camera, scene.sensor)
    labels = model.labels.reshape(-1)[seen.index]
    return pw.information(seen, model.coefficients, labels)


def test_sequential_search_in_regions_reports_the_frames_information(corner):
    """True regions: every plane is found, and Phi is that of the whole frame."""
    model = pw.detect_planes(
        corner.depth, corner.camera, corner.sensor, search="sequential", partition=corner.labels
    )
    assert model.information == pytest.approx(exact_phi(model, corner), rel=1e-9)
    assert len(model) == len(corner.planes)
    worth = [plane.information for plane in model.planes]
    assert worth == sorted(worth)
    assert corner.found(model.labels).all()
    assert model.curve[len(model)] == pytest.approx(model.information)
    assert model.curve.chosen == len(model)
    assert model.curve[0] == pytest.approx(corner_empty(corner))
    for k in range(len(model)):
        small = model.top(k)
        assert small.information == pytest.approx(exact_phi(small, corner), rel=1e-9)
    assert model.settings["partition"] == "label image"
    assert model.settings["partition_options"]["region_planes"] == 4


def test_readings_are_reassigned_after_a_search_in_regions(corner):
    model = pw.detect_planes(
        corner.depth,
        corner.camera,
        corner.sensor,
        search="sequential",
        partition=corner.labels,
        reassign="normals",
    )
    assert model.information == pytest.approx(exact_phi(model, corner), rel=1e-9)
    assert model.curve.moves[-1].kind == "reassign"


def corner_empty(scene):
    seen = pw.observe(scene.depth, scene.camera, scene.sensor)
    return pw.information(seen, np.empty((0, 4)), np.zeros(seen.count, int))


def test_blocks_of_one_plane_are_merged(camera):
    wall = 2.0 + np.random.default_rng(0).normal(0, 0.004, SHAPE)
    partition = Blocks(rows=16, columns=16)
    model = pw.detect_planes(
        wall, camera, pw.Sensor(noise=0.004), search="sequential", partition=partition
    )
    assert len(model) == 1
    assert model.planes[0].count > 0.9 * wall.size
    assert [move.kind for move in model.curve.moves][:2] == ["regions", "merge"]


def test_planes_that_do_not_pay_for_the_frame_are_left_out(corner):
    """More planes than pay: no shorter list of the best has a lower Phi."""
    partition = Blocks(rows=10, columns=10)
    model = pw.detect_planes(
        corner.depth, corner.camera, corner.sensor, search="sequential", partition=partition
    )
    assert model.information == pytest.approx(min(model.prefix), rel=1e-12)
    one = pw.detect_planes(
        corner.depth, corner.camera, corner.sensor, search="sequential", partition=partition,
        max_planes=1,
    )  # fmt: skip
    assert len(one) == 1
    assert one.information > model.information
    assert one.curve.reason == "reached max_planes = 1"


def test_regions_without_depth_and_of_few_readings(corner):
    depth, labels = corner.depth.copy(), np.ones(corner.depth.shape, int)
    depth[:30], labels[:30] = 0, 2  # a region without depth
    labels[60, 80:82] = 3  # too few readings for a plane
    for options in ({"search": "sequential"}, {"objective": "paper"}, {}):
        model = pw.detect_planes(depth, corner.camera, corner.sensor, partition=labels, **options)
        assert len(model) >= 3
        assert not model.labels[:30].any()
    empty = np.zeros_like(depth)
    for search in ("joint", "sequential"):
        model = pw.detect_planes(
            empty, corner.camera, corner.sensor, partition=labels, search=search
        )
        assert len(model) == 0
        assert "readings" in model.note


FRAMES = ["room", "nyu_0311", "nyu_0412"]


@pytest.fixture(scope="module", params=FRAMES)
def frame(request, real_frames):
    if request.param == "room":
        scene = scenes.room(0)
        return scene.depth, scene.camera, scene.sensor, None
    depth, camera, scale = real_frames("nyu_dpd", request.param)
    return depth, camera, pw.sensors.KINECT_V1, scale


@pytest.mark.parametrize("objective", ["spatial", "paper"])
def test_phi_never_rises_because_of_a_partition(frame, objective):
    depth, camera, sensor, scale = frame
    if objective == "paper":  # a third of the pixels each way will do
        depth = depth[::3, ::3]
        camera = pw.PinholeCamera(
            fx=camera.fx / 3, fy=camera.fy / 3, cx=camera.cx / 3, cy=camera.cy / 3
        )

    def detect(partition):
        return pw.detect_planes(
            depth, camera, sensor, depth_scale=scale, objective=objective, partition=partition
        )

    alone = detect(None)
    rng = np.random.default_rng(0)
    nonsense = rng.integers(0, 5, (depth.shape[0] // 20 + 1, depth.shape[1] // 20 + 1))
    nonsense = nonsense.repeat(20, 0).repeat(20, 1)[: depth.shape[0], : depth.shape[1]]
    for partition in (Blocks(rows=60, columns=80), nonsense):
        model = detect(partition)
        assert model.information <= alone.information
        assert model.information == pytest.approx(min(model.prefix), rel=1e-12)
        counts = np.bincount(model.labels.reshape(-1), minlength=len(model) + 1)[1:]
        assert counts.tolist() == [plane.count for plane in model.planes]
        assert all(np.isfinite(plane.covariance).all() for plane in model.planes)
        if objective == "spatial":
            assert all(np.isfinite(plane.significance) for plane in model.planes)


def test_spatial_information_with_regions_is_that_of_the_judge(real_frames):
    """A frame on which a partition helps: its Phi is exact, and it is another model."""
    from planewise.sectors import turn_to_theta
    from planewise.spatial.cells import cells_of
    from planewise.spatial.frame import frame_of
    from planewise.spatial.information import ledger

    depth, camera, scale = real_frames("nyu_dpd", "nyu_0412")
    sensor = pw.sensors.KINECT_V1
    alone = pw.detect_planes(depth, camera, sensor, depth_scale=scale)
    model = pw.detect_planes(depth, camera, sensor, depth_scale=scale, partition="blocks")
    assert model.information < alone.information - 100
    assert "regions" in [move.kind for move in model.curve.moves]
    seen = pw.observe(depth, camera, sensor, depth_scale=scale)
    image = frame_of(seen)
    theta = -model.coefficients[:, :3] / model.coefficients[:, 3:]
    affine = theta @ np.linalg.inv(turn_to_theta(seen.pixel_size)).T
    book = ledger(
        image, cells_of(image, seen.pixel_size), affine, model.labels, seen.range,
        seen.resolution, seen.pixel_size,
    )  # fmt: skip
    assert book.curve[-1] == pytest.approx(model.information, rel=1e-6)


@pytest.mark.parametrize("search", ["sequential", "joint"])
def test_a_stream_and_any_number_of_threads_give_the_same(corner, search):
    depth, camera, sensor = corner.depth, corner.camera, corner.sensor
    options = {"search": search, "partition": Blocks(rows=40, columns=40)}
    if search == "joint":
        options["objective"] = "paper"
    model = pw.detect_planes(depth, camera, sensor, threads=1, **options)
    before = depth.copy()
    detector = pw.Detector(camera, sensor, threads=3, **options)
    for _ in range(2):
        again = detector(depth)
        assert np.array_equal(again.labels, model.labels)
        assert again.information == model.information
    assert np.array_equal(depth, before)


def test_options_with_the_same_partition_are_equal():
    from planewise.options import Options

    assert Options(partition="graph") == Options(partition=Graph())
    assert hash(Options(partition="blocks")) == hash(Options(partition=Blocks()))
    assert Options(partition="graph") != Options()


@pytest.mark.parametrize("instances", [False, True])
def test_a_region_brings_back_what_lies_on_a_plane_that_is_known(instances):
    """A wall, and a piece of it seen past something bent that hides what is between."""
    camera = pw.PinholeCamera(fx=300, fy=300, cx=119.5, cy=89.5)
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:180, :240]
    depth = np.full((180, 240), 2.0)
    bent = (x > 120) & (x < 180)
    depth[bent] = (1.2 + 0.2 * np.cos((x - 150) / 10) + 0.1 * np.sin(y / 9))[bent]
    depth += rng.normal(0, 0.002, depth.shape)
    sensor = pw.Sensor(noise=0.002)
    regions = np.where(x >= 180, 2, np.where(bent, 0, 1))
    alone = pw.detect_planes(depth, camera, sensor, instances=instances)
    model = pw.detect_planes(depth, camera, sensor, instances=instances, partition=regions)
    assert model.information <= alone.information
    assert (model.labels[20:160, 20:110] > 0).all()
    assert (model.labels[20:160, 200:230] > 0).all()
    assert np.mean(model.labels[bent] > 0) < 0.2


def test_a_frame_without_planes_stays_without(camera):
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 3, SHAPE)
    for options in ({}, {"search": "sequential"}, {"objective": "paper"}):
        model = pw.detect_planes(
            depth, camera, pw.Sensor(noise=0.002), partition=Blocks(rows=16, columns=16), **options
        )
        assert len(model) == 0
        assert model.note


def test_largest_number_of_planes_holds_with_regions(real_frames):
    depth, camera, scale = real_frames("nyu_dpd", "nyu_0412")
    model = pw.detect_planes(
        depth, camera, pw.sensors.KINECT_V1, depth_scale=scale, partition="blocks", max_planes=5
    )
    assert len(model) <= 5


def test_regions_may_offer_no_plane_though_the_whole_frame_has_one():
    """Regions too small for a plane, and no outliers to draw one from: there is no candidate."""
    camera = pw.PinholeCamera(fx=30, fy=30, cx=2, cy=6)
    sensor = pw.Sensor(noise=0.2, max_depth=6)
    wall, rows = np.full((12, 4), 2.0), np.arange(48).reshape(12, 4) // 6 + 1
    model = pw.detect_planes(wall, camera, sensor, objective="paper", partition=rows)
    assert len(model) == 1
    assert (model.labels == 1).all()


def test_joint_information_is_never_above_what_regions_alone_give():
    """The joint search misses two of 6 x 6 squares that regions give."""
    side, rng = 240, np.random.default_rng(0)
    y, x = np.mgrid[:side, :side] * 6 // side
    squares = 6 * y + x
    depth = (2 + 0.11 * rng.permutation(36))[squares] + rng.normal(0, 0.005, (side, side))
    camera = pw.PinholeCamera(fx=250, fy=250, cx=120, cy=120)
    scene = {"camera": camera, "sensor": pw.Sensor(noise=0.005, max_depth=10)}
    alone = pw.detect_planes(depth, **scene, objective="paper")
    model = pw.detect_planes(depth, **scene, objective="paper", partition=squares + 1)
    regions = pw.detect_planes(depth, **scene, search="sequential", partition=squares + 1)
    assert regions.information < alone.information
    assert model.information <= regions.information * (1 + 1e-9)
    assert len(model) == 36
    assert "regions" in [move.kind for move in model.curve.moves]
