from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont

import planewise as pw
from planewise.drawing.axes import CHOSEN, LINE
from planewise.drawing.curve import draw_curve
from planewise.drawing.overlay import (
    _short,
    _write_ranks,
    draw_labels,
    draw_overlay,
    match_picture,
)
from planewise.drawing.palette import distinct_colours
from planewise.errors import PlanewiseError
from planewise.files.colour import read_colour
from planewise.results.image import depth_in_metres


def test_small_images_are_magnified_and_planes_have_their_colours(scene, model):
    depth = depth_in_metres(scene.depth, scene.sensor)
    picture = draw_overlay(model, depth, scene.camera)
    assert picture.dtype == np.uint8
    assert picture.shape[0] == 4 * 120
    assert picture.shape[1] > 4 * 160  # the legend
    colours = distinct_colours(len(model)).astype(float)
    seen = picture[:480, :640].reshape(120, 4, 160, 4, 3)[:, 2, :, 2].astype(float)
    for label, colour in enumerate(colours, start=1):
        mean = seen[model.labels == label].mean(axis=0)
        direction = mean / np.linalg.norm(mean)
        likeness = colours @ direction / np.linalg.norm(colours, axis=1)
        assert likeness.argmax() == label - 1
        legend = picture[:, 640:]
        assert (legend == colour.astype(np.uint8)).all(axis=2).sum() > 50


def test_flat_strips_are_magnified_less_across():
    camera, depth = pw.PinholeCamera(fx=500, fy=500, cx=1000, cy=2), np.full((4, 1500), 2.0)
    model = pw.detect_planes(depth, camera, pw.Sensor())
    picture = draw_overlay(model, depth, camera)
    assert picture.shape[0] == 400
    assert 3000 < picture.shape[1] < 4000


def test_inputs_are_not_changed(scene, model):
    depth = depth_in_metres(scene.depth, scene.sensor)
    before, rgb = depth.copy(), scene.rgb.copy()
    draw_overlay(model, depth, scene.camera, rgb=scene.rgb)
    draw_labels(scene.labels, scene.rgb)
    assert np.array_equal(depth, before, equal_nan=True)
    assert np.array_equal(rgb, scene.rgb)


def test_what_was_not_measured_is_dark_and_what_is_no_plane_is_grey(scene, model):
    depth = depth_in_metres(scene.depth, scene.sensor)
    labels = model.labels.copy()
    depth[:20], labels[:20] = np.nan, 0
    labels[100:] = 0
    planes = pw.PlaneModel(**{**vars(model), "labels": labels})
    picture = draw_overlay(planes, depth, scene.camera)[:480, :640].astype(int)
    assert picture[:70].max() < 40
    assert np.ptp(picture[420:], axis=2).max() <= 1
    assert picture[420:].mean() > 60


@pytest.mark.parametrize("size", [(60, 80), (240, 320)])
def test_picture_of_another_size_is_fitted(scene, model, size):
    depth = depth_in_metres(scene.depth, scene.sensor)
    rgb = np.full((*size, 3), 128, np.uint8)
    assert draw_overlay(model, depth, scene.camera, rgb=rgb).shape[0] == 480
    assert match_picture(rgb, (120, 160)).shape == (120, 160, 3)


@pytest.mark.parametrize("shape", [(100, 100, 3), (120, 160), (120, 160, 4)])
def test_unfit_pictures_are_refused(shape):
    with pytest.raises(PlanewiseError, match="rgb"):
        match_picture(np.zeros(shape, np.uint8), (120, 160))


def test_pictures_are_read(tmp_path):
    Image.fromarray(np.full((4, 5), 7, np.uint8)).save(tmp_path / "grey.png")
    assert np.array_equal(read_colour(tmp_path / "grey.png"), np.full((4, 5, 3), 7))
    (tmp_path / "junk.png").write_bytes(b"junk")
    for name in ("junk.png", "none.png"):
        with pytest.raises(PlanewiseError, match=f"the picture {name}"):
            read_colour(tmp_path / name)


@pytest.mark.parametrize(
    ("nats", "text"),
    [
        (-949.6, "-950"), (-9949.4, "-9,949"), (-9950.0, "-9.9 k"), (-999_949.0, "-999.9 k"),
        (-1_370_500.0, "-1.37 M"), (-9_995_000.0, "-10.0 M"), (-99_950_000.0, "-100 M"),
        (-133_174_321.0, "-133 M"), (-888_888_888.0, "-889 M"), (-999_500_000.0, "-1.00 G"),
    ],
)  # fmt: skip
def test_nats_of_the_legend_fit_their_column(nats, text):
    assert _short(nats) == text
    pen = ImageDraw.Draw(Image.new("RGB", (9, 9)))
    for size in (13, 21, 40):
        left = pen.textbbox((7 * size, 0), text, font=ImageFont.load_default(size), anchor="rm")[0]
        assert left > 3.2 * size  # ranks end at 2.9


def ranks_on(labels):
    canvas = Image.new("RGB", (labels.shape[1] + 40, labels.shape[0]), (128, 128, 128))
    _write_ranks(ImageDraw.Draw(canvas), labels, 13)
    return np.asarray(canvas)[..., 0]


@pytest.mark.parametrize("column", [0, 79])
def test_ranks_stay_in_the_picture_whole(column):
    labels = np.zeros((60, 80), np.uint16)
    labels[:, column] = 88
    edge, inside = ranks_on(labels), ranks_on(np.roll(labels, 40, axis=1))
    assert (edge[:, 80:] == 128).all()
    assert (edge == 255).sum() == (inside == 255).sum()


def test_ranks_are_not_written_over_those_of_better_planes():
    labels = np.zeros((60, 80), np.uint16)
    labels[30, 30:33] = 1
    alone = ranks_on(labels)
    labels[31, 30:33] = 2
    assert np.array_equal(ranks_on(labels), alone)
    labels[10, 30:33] = 3
    assert not np.array_equal(ranks_on(labels), alone)


def test_empty_and_crowded_models_are_drawn(scene, model):
    depth = np.full((120, 160), np.nan)
    empty = pw.detect_planes(depth, scene.camera, scene.sensor)
    assert draw_overlay(empty, depth, scene.camera).shape[0] == 480
    labels = (np.arange(120 * 160) // 300).reshape(120, 160).astype(np.uint16)
    crowd = pw.PlaneModel(
        **{**vars(model), "labels": labels, "planes": model.planes[:1] * int(labels.max())}
    )
    wide = draw_overlay(crowd, depth_in_metres(scene.depth, scene.sensor), scene.camera)
    assert wide.shape[1] > 640 + 2 * 150  # the legend takes further columns


def test_colours_stay_apart_and_do_not_depend_on_their_number():
    colours = distinct_colours(40).astype(int)
    assert np.array_equal(colours[:10], distinct_colours(10))
    apart = np.abs(colours[:, None] - colours[None]).sum(axis=2) + 1000 * np.eye(40, dtype=int)
    assert apart[:12, :12].min() > 90
    assert apart.min() > 25
    assert distinct_colours(0).shape == (0, 3)
    assert distinct_colours(1000).shape == (1000, 3)


@pytest.mark.parametrize(
    ("values", "chosen"),
    [([0.0], 0), ([5000.0], 0), ([100, 20, 25], 1), (np.linspace(3e6, 1e6, 65), 64), ([-5, -9], 1)],
)
def test_curves_of_any_kind_are_drawn(values, chosen):
    curve = pw.Curve(information=np.asarray(values, float), chosen=chosen, reason="")
    picture = draw_curve(curve)
    assert picture.shape == (500, 800, 3)
    mark = (np.abs(picture.astype(int) - (200, 85, 61)).sum(axis=2) < 12).sum()
    assert mark > 150  # the chosen number is marked


def test_what_is_said_of_the_chosen_point_keeps_clear_of_the_curve():
    values = 1_340_000 + 80_000 * np.exp(-np.arange(16) / 2.0)
    picture = draw_curve(pw.Curve(information=values, chosen=15, reason="")).astype(int)
    words = np.abs(picture - CHOSEN).sum(axis=2) < 60
    line = np.abs(picture - LINE).sum(axis=2) < 60
    columns = np.flatnonzero(words.any(axis=0) & line.any(axis=0))
    columns = columns[columns < columns.max() - 40]  # not the point itself, nor its dashes
    assert columns.size > 20
    lowest = [np.flatnonzero(words[:, x]).max() for x in columns]
    highest = [np.flatnonzero(line[:, x]).min() for x in columns]
    assert min(np.subtract(highest, lowest)) >= 8
