from __future__ import annotations

import json
import math
import sys

import jsonschema
import numpy as np
import plyfile
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from shapely import Polygon as Shape

import planewise as pw
from planewise import scenes
from planewise.errors import MissingExtraError
from planewise.files.result_names import OUTLINE_FILES
from planewise.model import Curve, Plane, PlaneModel
from planewise.outlines.cloud import outline_points
from planewise.outlines.image import outline_image
from planewise.outlines.label_borders import regions
from planewise.outlines.outlines import PlaneFrame, as_shapely, surfaces_of
from planewise.results.mesh import triangulate
from planewise.results.outlines import (
    OUTLINES_SCHEMA_FILE,
    describe_outlines,
    write_outlines,
)
from tests.command import run

CAMERA = pw.PinholeCamera(fx=300, fy=310, cx=160, cy=118)
SHAPE = (240, 320)


def plane_at(normal, centroid):
    """Plane through a point, its normal turned to the origin."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    distance = -normal @ centroid
    if distance < 0:
        normal, distance = -normal, -distance
    return Plane(
        normal=normal,
        distance=distance,
        information=-1.0,
        count=1,
        rms=0.0,
        centroid=np.asarray(centroid, float),
        covariance=np.eye(4),
    )


def model_of(labels, *planes):
    return PlaneModel(
        labels=np.asarray(labels, np.uint16),
        planes=planes,
        information=0.0,
        curve=Curve(information=np.zeros(1), chosen=0, reason=""),
        readings=1,
        prefix=(0.0,),
        search="joint",
        objective="paper",
    )


def seen(shapes, plane, camera=CAMERA):
    """Labels of the pixels whose ray meets the plane in a shape: rows of a, b and half sides."""
    rays = camera.rays(SHAPE)
    depth = -plane.distance / (rays @ plane.normal)
    flat = PlaneFrame.of(plane).to_plane(rays * depth[..., None])
    labels = np.zeros(SHAPE, bool)
    for (a, b), (half_a, half_b), value in shapes:
        labels[(abs(flat[..., 0] - a) < half_a) & (abs(flat[..., 1] - b) < half_b)] = value
    return labels


def sampled(shapes, plane, number, rng):
    """Random points of the same shapes in space."""
    flat = rng.uniform(-2, 2, (number, 2))
    inside = np.zeros(number, bool)
    for (a, b), (half_a, half_b), value in shapes:
        inside[(abs(flat[:, 0] - a) < half_a) & (abs(flat[:, 1] - b) < half_b)] = value
    return PlaneFrame.of(plane).to_space(flat[inside])


FRAMED = [((0, 0), (0.6, 0.4), True), ((0.1, 0.05), (0.2, 0.15), False)]
TABLES = [((-0.5, 0), (0.3, 0.3), True), ((0.5, 0.1), (0.2, 0.2), True)]
TILTED = plane_at((0.3, -0.4, -1), (0.05, 0.1, 2.0))


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.integers(0, 99))
def test_frames_are_orthonormal_and_lie_on_the_plane(normal, seed):
    if np.linalg.norm(normal) < 0.1:
        normal = [0, 0, 1]
    rng = np.random.default_rng(seed)
    plane = plane_at(normal, rng.normal(size=3))
    frame = PlaneFrame.of(plane)
    axes = np.stack((frame.u, frame.v, frame.normal))
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    flat = rng.normal(size=(5, 2))
    points = frame.to_space(flat)
    assert_allclose(points @ plane.normal + plane.distance, 0, atol=1e-12)
    assert_allclose(frame.to_plane(points), flat, atol=1e-12)


def test_on_a_wall_that_faces_the_camera_u_is_right_and_v_up():
    frame = PlaneFrame.of(plane_at((0, 0, -1), (0.2, 0.1, 3.0)))
    assert_array_equal(frame.u, [1, 0, 0])
    assert_array_equal(frame.v, [0, -1, 0])
    assert_array_equal(frame.origin, [0.2, 0.1, 3.0])


@pytest.mark.parametrize("tolerance", [0.0, 1.5])
def test_rectangle_with_a_hole_in_an_image(tolerance):
    labels = seen(FRAMED, TILTED)
    (surface,) = outline_image(model_of(labels, TILTED), CAMERA, tolerance=tolerance)
    (polygon,) = surface.polygons
    (hole,) = polygon.holes
    pixel = 2.0 / 300 * 1.2  # at its depth and tilt, metres
    border = 2 * (1.2 + 0.8 + 0.4 + 0.3)
    assert surface.area == pytest.approx(0.96 - 0.12, abs=border * pixel / 4)
    assert Shape(hole).area == pytest.approx(0.12, abs=1.4 * pixel / 2)
    assert surface.extent.length == pytest.approx(1.2, abs=2 * pixel)
    assert surface.extent.width == pytest.approx(0.8, abs=2 * pixel)
    true = Shape([(-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (-0.6, 0.4)])
    assert Shape(polygon.shell).hausdorff_distance(true) < 3 * pixel
    if tolerance:
        assert len(polygon.shell) < 30


def test_without_tolerance_regions_are_their_pixels_exactly():
    labels = np.random.default_rng(0).integers(0, 3, (40, 50))
    found = regions(labels, 0.0)
    for label in (1, 2):
        pieces = found[label]
        assert sum(piece.area for piece in pieces) == np.count_nonzero(labels == label)
        assert all(piece.is_valid for piece in pieces)
        inside = sum(
            piece.contains(Shape([(j - 0.4, i - 0.4), (j + 0.4, i - 0.4), (j, i + 0.4)]))
            for piece in pieces
            for i, j in np.argwhere(labels == label)[:60]
        )
        assert inside == 60
    assert regions(np.zeros((5, 5), int), 0.0) == {}


def test_neighbours_keep_a_common_border():
    rows, columns = np.indices((120, 160))
    labels = np.where(columns * 0.7 + rows > 100, 1, 2)
    labels[(rows - 60) ** 2 + (columns - 40) ** 2 < 500] = 3
    found = regions(labels, 1.5)
    shapes = [found[label][0] for label in (1, 2, 3)]
    assert sum(shape.area for shape in shapes) == pytest.approx(labels.size, rel=1e-12)
    for shape, label in zip(shapes, (1, 2, 3), strict=True):
        assert shape.area == pytest.approx(np.count_nonzero(labels == label), rel=0.02)
    assert shapes[0].intersection(shapes[1]).area == 0
    assert shapes[1].intersection(shapes[2]).area == 0
    assert len(shapes[0].exterior.coords) < 12


def ragged(labels, rng):
    """Labels whose borders wander: each pixel that of one beside it, three in ten times."""
    height, width = labels.shape
    rows, columns = np.indices(labels.shape) + rng.integers(-1, 2, (2, height, width)) * (
        rng.random((height, width)) < 0.3
    )
    return labels[rows.clip(0, height - 1), columns.clip(0, width - 1)]


@pytest.mark.parametrize("name", ["T", "L", "comb", "checkers"])
def test_simplified_regions_keep_their_labels(name):
    """Whatever the shape, of which a single pixel may lie beyond a simplified border."""
    rows, columns = np.indices((60, 80))
    labels = {
        "T": (rows < 7) | (abs(columns - 40) < 4),
        "L": (rows > 50) | (columns < 8),
        "comb": (rows < 7) | (columns % 12 < 5),
        "checkers": 1 + (rows // 9 + columns // 7) % 2,
    }[name].astype(int)
    rng = np.random.default_rng(0)
    for _ in range(30):
        seen = np.pad(ragged(labels, rng), 2)
        found = regions(seen, 1.5)
        for label in range(1, int(labels.max()) + 1):
            area = sum(piece.area for piece in found[label])
            assert area == pytest.approx(np.count_nonzero(seen == label), rel=0.1)


def test_ragged_labels_keep_to_half_a_pixel():
    """Half of the readings of two planes are missing here and there: 11,000 lines."""
    labels = np.where(np.arange(220) < 100, 1, 2) * np.ones((200, 1), int)
    labels[np.random.default_rng(0).random(labels.shape) < 0.5] = 0
    exact, found = regions(labels, 0.0), regions(labels, 1.5)
    for label in (1, 2):
        assert all(piece.is_valid for piece in found[label])
        # A hole of a single pixel is filled, and a piece of one left out.
        assert 0 < len(found[label]) < 0.5 * len(exact[label])
        mine, its = (shapely.union_all(each[label]) for each in (exact, found))
        assert its.difference(mine.buffer(0.5, join_style="mitre")).area < 1e-6
    one, two = (shapely.union_all(found[label]) for label in (1, 2))
    assert one.intersection(two).area < 1e-9


def test_a_real_segmentation_keeps_its_areas():
    scene = pw.scenes.room(0)
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    surfaces = outline_image(model, scene.camera, tolerance=0)
    assert [surface.plane for surface in surfaces] == list(range(1, len(model) + 1))
    for surface, plane in zip(surfaces, model.planes, strict=True):
        assert surface.area == pytest.approx(plane.area, rel=0.02)
        assert as_shapely(surface).is_valid
        for rings in surface.rings:
            assert_allclose(np.vstack(rings) @ plane.normal + plane.distance, 0, atol=1e-9)
    simplified = outline_image(model, scene.camera)
    for rough, fine, plane in zip(simplified, surfaces, model.planes, strict=True):
        pixel, border = np.sqrt(fine.area / plane.count), as_shapely(rough).length
        # Borders move by a third of the tolerance on average: little, but of the legs of the table.
        assert abs(rough.area - fine.area) < 0.5 * pixel * border
        if 2 * rough.area / border > 9 * pixel:
            assert rough.area == pytest.approx(fine.area, rel=0.05)


@pytest.mark.parametrize("instances", [False, True])
def test_two_tables_are_two_surfaces_of_one_plane(instances):
    rng = np.random.default_rng(0)
    points = sampled(TABLES, TILTED, 40_000, rng)
    image = outline_image(model_of(seen(TABLES, TILTED), TILTED), CAMERA, instances=instances)
    cloud = outline_points(model_of(np.ones(len(points)), TILTED), points, instances=instances)
    for surfaces in (image, cloud):
        assert {surface.plane for surface in surfaces} == {1}
        if instances:
            assert [surface.surface for surface in surfaces] == [1, 2]
            areas = [surface.area for surface in surfaces]
        else:
            assert [surface.surface for surface in surfaces] == [0]
            areas = [Shape(each.shell).area for each in surfaces[0].polygons]
            assert surfaces[0].area == pytest.approx(sum(areas))
        assert_allclose(areas, [0.36, 0.16], rtol=0.1)


@pytest.mark.parametrize("number", [8_000, 40_000, 400_000])
@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_rectangle_with_a_hole_in_a_cloud(number, turn):
    rng = np.random.default_rng(1)
    # A plane far from the axes: the rectangle is turned on it.
    plane = plane_at((0.3, -0.4, -1 + turn), (0.05, 0.1, 2.0))
    points = sampled(FRAMED, plane, number, rng)
    frame = PlaneFrame.of(plane)
    flat = frame.to_plane(points)
    turned = flat @ np.array(((math.cos(turn), math.sin(turn)), (-math.sin(turn), math.cos(turn))))
    points = frame.to_space(turned) + rng.normal(0, 0.003, len(points))[:, None] * plane.normal
    (surface,) = outline_points(model_of(np.ones(len(points)), plane), points)
    (polygon,) = surface.polygons
    (hole,) = polygon.holes
    few = number < 10_000  # some four hundred on the plane
    assert surface.area == pytest.approx(0.84, rel=0.12 if few else 0.03)
    assert Shape(hole).area == pytest.approx(0.12, rel=0.35 if few else 0.1)
    assert surface.extent.length == pytest.approx(1.2, rel=0.03)
    assert surface.extent.width == pytest.approx(0.8, rel=0.03)


def test_a_wall_above_a_pillar_has_an_outline():
    rng = np.random.default_rng(22)
    points = rng.uniform(0, (4, 3), (3000, 2))
    points = points[(points[:, 1] > 1.5) | (abs(points[:, 0] - 2) < 0.4)]
    cloud = np.column_stack((points, 1 + rng.normal(0, 0.004, len(points))))
    model = pw.detect_planes_in_points(cloud, pw.Sensor(max_depth=20, noise=0.005))
    (surface,) = outline_points(model, cloud)
    assert surface.area == pytest.approx(4 * 1.5 + 0.8 * 1.5, rel=0.05)


def test_lines_of_a_scanner_make_a_surface():
    rng = np.random.default_rng(2)
    rows = np.repeat(np.arange(0, 1, 0.05), 500)
    flat = np.column_stack((rng.uniform(0, 2, len(rows)), rows))
    plane = plane_at((0, 0, 1), (1, 0.5, -3))
    points = PlaneFrame.of(plane).to_space(flat)
    (surface,) = outline_points(model_of(np.ones(len(points)), plane), points)
    assert len(surface.polygons) == 1
    assert not surface.polygons[0].holes
    assert surface.area == pytest.approx(2 * 0.95, rel=0.05)


def test_strays_far_away_do_not_coarsen_the_outline():
    rng = np.random.default_rng(0)
    frame = PlaneFrame.of(TILTED)
    points = np.vstack(
        (sampled(FRAMED, TILTED, 40_000, rng), frame.to_space(rng.uniform(-60, 60, (100, 2))))
    )
    (surface,) = outline_points(model_of(np.ones(len(points)), TILTED), points)
    (polygon,) = surface.polygons
    assert surface.area == pytest.approx(0.84, rel=0.05)
    assert len(polygon.holes) == 1


def test_a_given_spacing_is_used():
    points = sampled([((0, 0), (1, 1), True)], TILTED, 100_000, np.random.default_rng(0))
    model = model_of(np.ones(len(points)), TILTED)
    (coarse,) = outline_points(model, points, spacing=0.3)
    assert coarse.area == pytest.approx(4, rel=0.05)
    for whole in (1, np.int64(1)):
        assert outline_points(model, points, spacing=whole)[0].area == pytest.approx(4, rel=0.3)
    for wider in (1.5, 50.0):  # than half of it: two cells lie across
        assert outline_points(model, points, spacing=wider)[0].area == pytest.approx(4, rel=0.02)
    for bad in (0, -1, math.nan, math.inf):
        with pytest.raises(ValueError, match="spacing"):
            outline_points(model, points, spacing=bad)


def test_pieces_of_sparse_cells_do_not_overlap():
    """Of cells with less than 1.6 points each as many reach beyond the border as lack."""
    points = sampled([((0, 0), (2, 1.5), True)], TILTED, 2_000, np.random.default_rng(0))
    (surface,) = outline_points(model_of(np.ones(len(points)), TILTED), points, spacing=0.07)
    assert len(surface.polygons) > 5
    assert as_shapely(surface).is_valid


def test_angles_of_extents_are_less_than_pi():
    rng = np.random.default_rng(0)
    for _ in range(100):  # of three the long side has a slope of -1e-17
        low, high = rng.uniform(-1, 0, 2), rng.uniform((2, 0.1), (4, 1))
        piece = Shape([low, (high[0], low[1]), high, (low[0], high[1])])
        (surface,) = surfaces_of(1, PlaneFrame.of(TILTED), [piece], instances=False)
        assert 0 <= surface.extent.angle < math.pi


@pytest.mark.parametrize(
    ("length", "width", "number"),
    [(20, 1.0, 100), (20, 0.6, 100), (20, 0.3, 400), (20, 0.1, 400), (20, 0.1, 2000)],
)
def test_narrow_strips_have_an_outline(length, width, number):
    frame = PlaneFrame.of(TILTED)
    turn = np.array(((0.8, 0.6), (-0.6, 0.8)))
    areas = []
    for seed in range(5):
        flat = np.random.default_rng(seed).uniform(0, 1, (number, 2)) * (length, width) @ turn
        (surface,) = outline_points(model_of(np.ones(number), TILTED), frame.to_space(flat))
        (polygon,) = surface.polygons
        assert Shape(polygon.shell).is_valid
        assert surface.extent.length == pytest.approx(length, rel=0.1)
        areas.append(surface.area / (length * width))
    assert 0.75 < min(areas) <= max(areas) < 1.05


def test_copies_of_points_do_not_change_an_outline():
    points = sampled(FRAMED, TILTED, 8_000, np.random.default_rng(2))
    copies = np.repeat(points, np.arange(len(points)) % 4 + 1, axis=0)
    once, again = (
        outline_points(model_of(np.ones(len(each)), TILTED), each)[0] for each in (points, copies)
    )
    assert again.area == pytest.approx(once.area, rel=1e-6)
    assert len(again.polygons[0].holes) == len(once.polygons[0].holes) == 1


@pytest.mark.parametrize(
    "flat",
    [
        np.ones((50, 2)),
        np.column_stack((np.linspace(0, 1, 50), np.linspace(0, 2, 50))),
        np.array(((0.0, 0.0),)),
        np.array(((0.0, 0.0), (1.0, 0.0))),
        np.array(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))),
        np.empty((0, 2)),
    ],
    ids=["one place", "line", "point", "two", "three", "none"],
)
def test_points_that_span_no_area_have_an_empty_outline(flat):
    points = PlaneFrame.of(TILTED).to_space(flat)
    model = model_of(np.ones(len(points)), TILTED)
    (surface,) = outline_points(model, points)
    assert surface.polygons == ()
    assert surface.area == 0
    assert surface.extent is None
    assert surface.corners.shape == (0, 3)
    assert outline_points(model, points, instances=True) == ()
    assert len(triangulate(surface).triangles) == 0


def test_single_pixels_and_lines_have_an_empty_outline():
    labels = np.zeros(SHAPE, np.uint16)
    labels[10, 10] = 1
    labels[20, 30:60] = 2
    (pixel, line, none) = outline_image(model_of(labels, TILTED, TILTED, TILTED), CAMERA)
    assert pixel.polygons == line.polygons == none.polygons == ()


def test_a_plane_seen_at_its_edge_stays_within_reach():
    # The horizon crosses the image: rays of the upper pixels never meet the floor.
    floor = plane_at((0, -1, -0.05), (0, 1.2, 3.0))
    (surface,) = outline_image(model_of(np.ones(SHAPE), floor), CAMERA, max_depth=10.0)
    depth = np.vstack([ring for rings in surface.rings for ring in rings])[:, 2]
    assert 5 < depth.max() < 16
    (surface,) = outline_image(model_of(np.ones(SHAPE), floor), CAMERA)
    assert np.isfinite(surface.area)


def test_distortion_bends_borders_in_the_image_only():
    camera = pw.PinholeCamera(
        fx=300, fy=310, cx=160, cy=118, distortion=(0.1, -0.02, 0.001, 0.001, 0.0)
    )
    labels = seen(FRAMED, TILTED, camera)
    (surface,) = outline_image(model_of(labels, TILTED), camera)
    assert surface.area == pytest.approx(0.84, rel=0.02)
    pixels = np.random.default_rng(0).uniform(0, 230, (50, 2))
    assert_allclose(camera.project(2 * camera.unproject(pixels)), pixels, atol=1e-6)


def test_outlines_end_where_the_lens_folds_the_image():
    camera = pw.PinholeCamera(fx=144, fy=144, cx=79.5, cy=59.5, distortion=(-0.33, 0, 0, 0))
    model = pw.detect_planes(np.full((120, 160), 2000, np.uint16), camera, pw.Sensor(noise=0.002))
    (surface,) = outline_image(model, camera, tolerance=0)
    assert surface.area == pytest.approx(model.planes[0].area, rel=0.02)
    assert 0.9 * 120 * 160 < model.planes[0].count < 120 * 160


@settings(max_examples=25)
@example(seed=2462)  # whose holes touch in a way that GEOS cannot triangulate
@given(seed=st.integers(0, 10_000))
def test_meshes_cover_their_polygons(seed):
    rng = np.random.default_rng(seed)
    labels = rng.random((14, 16)) < 0.6
    plane = plane_at(rng.normal(size=3) - (0, 0, 3), (0.1, 0.2, 2.0))
    (surface,) = outline_image(
        model_of(labels, plane), pw.PinholeCamera(fx=16, fy=16, cx=8, cy=7), tolerance=0
    )
    mesh = triangulate(surface)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(surface.area, rel=1e-9)
    assert (normals @ plane.normal > 0).all()
    assert_allclose(mesh.vertices @ plane.normal + plane.distance, 0, atol=1e-9)


OFFSET = np.array([536_258.0, 6_581_099.0, 47.0])


def test_files_hold_the_surfaces(tmp_path):
    plane = plane_at((0, 0.2, -1), (0, 0.1, 2.0))
    labels = seen(TABLES, TILTED) + 2 * seen([((0, -0.6), (0.2, 0.1), True)], plane)
    model = model_of(labels, TILTED, plane, TILTED)
    surfaces = outline_image(model, CAMERA)
    write_outlines(tmp_path, surfaces, frame="a test", offset=OFFSET)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(OUTLINE_FILES)

    record = json.loads((tmp_path / "outlines.json").read_text())
    jsonschema.validate(record, json.loads(OUTLINES_SCHEMA_FILE.read_text()))
    assert [each["properties"]["plane"] for each in record["features"]] == [1, 2, 3]
    first = record["features"][0]
    assert len(first["geometry"]["coordinates"]) == 2
    ring = np.array(first["geometry"]["coordinates"][0][0])
    flat = np.array(first["properties"]["plane_coordinates"][0][0])
    assert_array_equal(ring[0], ring[-1])
    origin, u, v = (np.array(first["properties"][name]) for name in ("origin", "u", "v"))
    assert_allclose(origin + flat @ np.stack((u, v)), ring, atol=1e-8)
    assert record["features"][2]["properties"]["extent"] is None

    mesh = plyfile.PlyData.read(str(tmp_path / "planes.ply"))
    corners = np.stack([mesh["vertex"][name] for name in "xyz"], axis=1)
    faces = np.stack(mesh["face"]["vertex_indices"])
    assert set(mesh["face"]["plane"].tolist()) == {1, 2}
    a, b, c = np.moveaxis(corners[faces] - OFFSET, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    for surface in surfaces[:2]:
        mine = mesh["face"]["plane"] == surface.plane
        assert areas[mine].sum() == pytest.approx(surface.area, rel=1e-6)
        on = (corners[faces[mine]] - OFFSET) @ surface.frame.normal
        assert_allclose(on, on.mean(), atol=1e-8)

    lines = (tmp_path / "planes.obj").read_text().splitlines()
    places = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    assert_allclose(places, corners, atol=1e-9)
    triangles = [
        [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
        for line in lines
        if line.startswith("f ")
    ]
    assert_array_equal(triangles, faces)
    assert [line for line in lines if line.startswith("o ")] == ["o plane_1", "o plane_2"]
    used = {line.split()[1] for line in lines if line.startswith("usemtl")}
    made = (tmp_path / "planes.mtl").read_text()
    assert all(f"newmtl {name}\n" in made for name in used)


def test_a_model_without_planes_has_no_surfaces(tmp_path):
    assert outline_image(model_of(np.zeros(SHAPE)), CAMERA) == ()
    assert outline_points(model_of(np.zeros(9)), np.zeros((9, 3))) == ()
    write_outlines(tmp_path, (), frame="")
    record = describe_outlines((), frame="", offset=np.zeros(3))
    jsonschema.validate(record, json.loads(OUTLINES_SCHEMA_FILE.read_text()))
    assert len(plyfile.PlyData.read(str(tmp_path / "planes.ply"))["face"].data) == 0


def test_bad_arguments_are_named():
    model = model_of(np.ones(9), TILTED)
    with pytest.raises(ValueError, match="points"):
        outline_points(model, np.zeros((8, 3)))
    with pytest.raises(ValueError, match="points"):
        outline_points(model, np.zeros((9, 2)))
    with pytest.raises(ValueError, match="model"):
        outline_image(model, CAMERA)
    image = model_of(np.ones(SHAPE), TILTED)
    with pytest.raises(ValueError, match="tolerance"):
        outline_image(image, CAMERA, tolerance=-1)
    with pytest.raises(ValueError, match="camera is for images of 640 x 480 pixels"):
        outline_image(image, pw.cameras.KINECT_V1)
    with pytest.raises(ValueError, match="camera must be a planewise"):
        outline_image(image, "nyu")
    for outline, rest in ((outline_image, CAMERA), (outline_points, np.zeros((9, 3)))):
        with pytest.raises(ValueError, match=r"model must be a PlaneModel, .* got a NoneType"):
            outline(None, rest)
    with pytest.raises(ValueError, match=r"points must be an array; .* cloud\.points"):
        outline_points(model, pw.PointCloud(points=np.zeros((9, 3))))
    for spacing in ("a", 0, np.nan):
        with pytest.raises(ValueError, match="spacing must be a positive number of metres, got"):
            outline_points(model, np.zeros((9, 3)), spacing=spacing)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("max_depth", wrong) for wrong in (0, -1, np.nan, None, "a")),
        *(("tolerance", wrong) for wrong in (-1, np.nan, None, "a")),
    ],
)
def test_bad_settings_are_named(name, wrong):
    with pytest.raises(ValueError, match=f"{name} must be a .*number"):
        outline_image(model_of(np.ones(SHAPE), TILTED), CAMERA, **{name: wrong})


def test_points_may_be_a_list_or_masked():
    points = np.random.default_rng(0).uniform(0, 1, (300, 3)) * (1, 1, 0) + (0, 0, 2)
    points[0] = 9
    labels = np.arange(300) > 0
    model = model_of(labels, plane_at((0, 0, 1), (0, 0, 2)))
    (expected,) = outline_points(model, points)
    masked = np.ma.array(points, mask=np.broadcast_to(~labels[:, None], points.shape))
    for given_points in (points.tolist(), masked):
        assert outline_points(model, given_points)[0].area == expected.area > 0


def test_without_shapely_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(MissingExtraError, match=r"shapely.*planewise\[cloud\]"):
        outline_points(model_of(np.ones(9), TILTED), np.zeros((9, 3)))


def test_points_that_are_missing_make_no_outline(tmp_path):
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(0, 4, (3000, 2)), rng.normal(0, 0.005, 3000)))
    model = pw.detect_planes_in_points(points, pw.Sensor(noise=0.005))
    few = np.ma.array(points, mask=False)
    few.mask[:9] = True
    (whole,), (part,) = outline_points(model, points), outline_points(model, few)
    assert part.area == pytest.approx(whole.area, rel=0.02)


def test_outlines_of_a_lidar_are_in_its_frame(tmp_path):
    street = scenes.street(0)
    np.save(tmp_path / "a.npy", street.depth * 0.001)
    code, _, errors = run(
        "detect", tmp_path / "a.npy", "--camera", "ouster-os1-64", "--noise", 0.02, "--outlines",
        "-o", tmp_path / "out",
    )  # fmt: skip
    assert code == 0, errors
    for name in ("planes", "outlines"):
        told = json.loads((tmp_path / f"out/{name}.json").read_text())
        assert told["frame"].startswith("x forward, y left, z up")
